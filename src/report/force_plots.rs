//! Pictures of identification and error budgets (SVG).

use crate::identify::sweep::SweepFit;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use thiserror::Error;

/// A picture that could not be drawn.
#[derive(Debug, Error)]
#[error("drawing the picture: {0}")]
pub struct PlotError(String);

impl PlotError {
    fn from_any(error: impl std::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// One line of a picture.
pub struct Curve {
    /// Text in the legend.
    pub label: String,
    /// Points.
    pub points: Vec<(f64, f64)>,
    /// Dots instead of a line.
    pub dots: bool,
}

/// One panel over a logarithmic axis.
pub struct Panel {
    /// Title.
    pub title: String,
    /// Name and unit of the horizontal, logarithmic axis.
    pub x_label: String,
    /// Name and unit of the vertical axis.
    pub y_label: String,
    /// Vertical axis logarithmic.
    pub log_y: bool,
    /// Curves.
    pub curves: Vec<Curve>,
}

/// Measured against fitted: gain, phase and coherence of motor and stage.
/// Errors: the drawing library refused.
pub fn response_svg(axis: &str, fit: &SweepFit) -> Result<String, PlotError> {
    let points = |value: &dyn Fn(&crate::identify::sweep::ResponsePoint) -> f64| {
        fit.points.iter().map(|p| (p.frequency_hz, value(p))).collect::<Vec<_>>()
    };
    let curve =
        |label: &str, dots: bool, points: Vec<(f64, f64)>| Curve { label: label.to_owned(), points, dots };
    let panels = [
        Panel {
            title: format!("axis {axis}: acceleration per thrust, gain"),
            x_label: "Hz".to_owned(),
            y_label: "1/kg".to_owned(),
            log_y: true,
            curves: vec![
                curve("motor, measured", true, points(&|p| p.motor_1_kg[0].norm())),
                curve("motor, fitted", false, points(&|p| p.motor_1_kg[1].norm())),
                curve("stage, measured", true, points(&|p| p.stage_1_kg[0].norm())),
                curve("stage, fitted", false, points(&|p| p.stage_1_kg[1].norm())),
            ],
        },
        Panel {
            title: "phase".to_owned(),
            x_label: "Hz".to_owned(),
            y_label: "degrees".to_owned(),
            log_y: false,
            curves: vec![
                curve("motor, measured", true, points(&|p| p.motor_1_kg[0].arg().to_degrees())),
                curve("motor, fitted", false, points(&|p| p.motor_1_kg[1].arg().to_degrees())),
                curve("stage, measured", true, points(&|p| p.stage_1_kg[0].arg().to_degrees())),
                curve("stage, fitted", false, points(&|p| p.stage_1_kg[1].arg().to_degrees())),
            ],
        },
        Panel {
            title: "coherence with the thrust".to_owned(),
            x_label: "Hz".to_owned(),
            y_label: "squared coherence".to_owned(),
            log_y: false,
            curves: vec![
                curve("motor", false, points(&|p| p.coherence[0])),
                curve("stage", false, points(&|p| p.coherence[1])),
            ],
        },
    ];
    panels_svg(&panels)
}

/// Panels below each other.
/// Errors: the drawing library refused.
pub fn panels_svg(panels: &[Panel]) -> Result<String, PlotError> {
    let mut text = String::new();
    {
        let height = 300 * u32::try_from(panels.len().max(1)).unwrap_or(1);
        let root = SVGBackend::with_string(&mut text, (900, height)).into_drawing_area();
        root.fill(&WHITE).map_err(PlotError::from_any)?;
        for (area, panel) in root.split_evenly((panels.len().max(1), 1)).iter().zip(panels) {
            draw_panel(area, panel)?;
        }
        root.present().map_err(PlotError::from_any)?;
    }
    Ok(text)
}

fn draw_panel<B: DrawingBackend>(
    area: &DrawingArea<B, plotters::coord::Shift>,
    panel: &Panel,
) -> Result<(), PlotError> {
    let all = || panel.curves.iter().flat_map(|c| &c.points).filter(|(x, y)| x.is_finite() && y.is_finite());
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
    for (x, y) in all().filter(|(_, y)| !panel.log_y || *y > 0.0) {
        (low, high) = (low.min(*y), high.max(*y));
        (left, right) = (left.min(*x), right.max(*x));
    }
    if !(low <= high && left < right) {
        return Ok(());
    }
    let mut builder = ChartBuilder::on(area);
    builder.caption(&panel.title, ("sans-serif", 16)).margin(8).x_label_area_size(34).y_label_area_size(70);
    let x_axis = (left..right).log_scale();
    if panel.log_y {
        let range = (low * 0.8..high * 1.25).log_scale();
        let chart = builder.build_cartesian_2d(x_axis, range).map_err(PlotError::from_any)?;
        draw_curves(chart, panel)
    } else {
        let pad = 0.05 * (high - low).max(1e-12);
        let range: std::ops::Range<f64> = low - pad..high + pad;
        let chart =
            builder.build_cartesian_2d(x_axis, RangedCoordf64::from(range)).map_err(PlotError::from_any)?;
        draw_curves(chart, panel)
    }
}

fn draw_curves<'a, B, X, Y>(
    mut chart: ChartContext<'a, B, Cartesian2d<X, Y>>,
    panel: &Panel,
) -> Result<(), PlotError>
where
    B: DrawingBackend + 'a,
    X: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + plotters::coord::ranged1d::ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .light_line_style(WHITE)
        .draw()
        .map_err(PlotError::from_any)?;
    for (index, curve) in panel.curves.iter().enumerate() {
        let color =
            Palette99::pick(index / if panel.curves.iter().any(|c| c.dots) { 2 } else { 1 }).to_rgba();
        let points = || curve.points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite());
        let series = if curve.dots {
            chart
                .draw_series(points().map(|p| Circle::new(p, 2, color.stroke_width(1))))
                .map_err(PlotError::from_any)?
        } else {
            chart
                .draw_series(LineSeries::new(points(), color.stroke_width(1)))
                .map_err(PlotError::from_any)?
        };
        series.label(&curve.label).legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 14, y)], color));
    }
    chart
        .configure_series_labels()
        .border_style(BLACK.mix(0.3))
        .background_style(WHITE.mix(0.8))
        .draw()
        .map_err(PlotError::from_any)
}
