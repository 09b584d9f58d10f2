//! The stability map as a picture: growth over the two axes of the grid with the most values, islands and
//! all.

use crate::stability::{Grid, GridPoint};
use plotters::prelude::*;

const WIDTH: u32 = 900;
const HEIGHT: u32 = 640;

struct Axis {
    title: &'static str,
    scale: f64,
    count: usize,
    value: fn(&GridPoint) -> f64,
}

/// SVG text. Errors: the picture cannot be drawn (a fault of ours).
pub fn draw(grid: &Grid, points: &[GridPoint]) -> anyhow::Result<String> {
    let mut axes = [
        Axis {
            title: "spindle speed, rpm",
            scale: 1.0,
            count: grid.speed_rpm.count(),
            value: |p| p.speed_rpm,
        },
        Axis {
            title: "pitch angle difference, degrees",
            scale: 57.295_779_513_082_32,
            count: grid.pitch_rad.count(),
            value: |p| p.pitch_rad,
        },
        Axis { title: "width of cut, mm", scale: 1e3, count: grid.width_m.count(), value: |p| p.width_m },
        Axis {
            title: "tools from the chuck, mm",
            scale: 1e3,
            count: grid.position_m.count(),
            value: |p| p.position_m,
        },
    ];
    axes.sort_by_key(|a| std::cmp::Reverse(a.count));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, (WIDTH, HEIGHT)).into_drawing_area();
        root.fill(&WHITE).map_err(fault)?;
        if axes[1].count > 1 {
            map(&root, &axes, points)?
        } else {
            curve(&root, &axes[0], points)?
        }
        root.present().map_err(fault)?;
    }
    Ok(svg)
}

fn fault(error: impl std::fmt::Display) -> anyhow::Error {
    anyhow::anyhow!("drawing the stability map: {error}")
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// Both axes vary: one cell a point. Where more than two vary, the first values of the others.
fn map(root: &Area<'_>, axes: &[Axis; 4], points: &[GridPoint]) -> anyhow::Result<()> {
    let [x, y, rest @ ..] = axes;
    let first = &points[0];
    let same = |p: &&GridPoint| rest.iter().all(|a| ((a.value)(p) - (a.value)(first)).abs() <= 0.0);
    let shown: Vec<&GridPoint> = points.iter().filter(same).collect();
    let (xs, ys) = (range_of(x, points), range_of(y, points));
    let cell = |r: (f64, f64), n: usize| (r.1 - r.0) / (n.max(2) - 1) as f64 / 2.0;
    let (dx, dy) = (cell(xs, x.count), cell(ys, y.count));
    let title = "growth of small vibration, 1/s: red grows, blue fades, black line: limit";
    let mut chart = ChartBuilder::on(root)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(62)
        .build_cartesian_2d(xs.0 - dx..xs.1 + dx, ys.0 - dy..ys.1 + dy)
        .map_err(fault)?;
    chart.configure_mesh().x_desc(x.title).y_desc(y.title).disable_mesh().draw().map_err(fault)?;
    let most = shown.iter().fold(1.0f64, |m, p| m.max(p.root.growth_1_s.abs())).min(80.0);
    let cells = shown.iter().map(|p| {
        let (px, py) = ((x.value)(p) * x.scale, (y.value)(p) * y.scale);
        Rectangle::new([(px - dx, py - dy), (px + dx, py + dy)], colour(p.root.growth_1_s, most).filled())
    });
    chart.draw_series(cells).map_err(fault)?;
    Ok(())
}

/// One axis varies: growth over it.
fn curve(root: &Area<'_>, x: &Axis, points: &[GridPoint]) -> anyhow::Result<()> {
    let xs = range_of(x, points);
    let xs = if xs.1 > xs.0 { xs } else { (xs.0 - 0.5, xs.1 + 0.5) };
    let growth: Vec<f64> = points.iter().map(|p| p.root.growth_1_s).collect();
    let low = growth.iter().fold(-1.0f64, |m, g| m.min(*g)) * 1.05;
    let high = growth.iter().fold(1.0f64, |m, g| m.max(*g)) * 1.05;
    let mut chart = ChartBuilder::on(root)
        .caption("growth of small vibration, 1/s: above zero it chatters", ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(46)
        .y_label_area_size(62)
        .build_cartesian_2d(xs.0..xs.1, low..high)
        .map_err(fault)?;
    chart.configure_mesh().x_desc(x.title).y_desc("growth, 1/s").draw().map_err(fault)?;
    let line = |y: fn(&GridPoint) -> f64| points.iter().map(move |p| ((x.value)(p) * x.scale, y(p)));
    chart.draw_series(LineSeries::new(line(|p| p.root.growth_1_s), &RGBColor(178, 24, 43))).map_err(fault)?;
    chart.draw_series(LineSeries::new(line(|_| 0.0), &BLACK)).map_err(fault)?;
    Ok(())
}

fn range_of(axis: &Axis, points: &[GridPoint]) -> (f64, f64) {
    let values = || points.iter().map(|p| (axis.value)(p) * axis.scale);
    (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
}

/// Red above zero, blue below, black within half a unit of the limit.
fn colour(growth_1_s: f64, most: f64) -> RGBColor {
    if growth_1_s.abs() < 0.004 * most {
        return BLACK;
    }
    let depth = (growth_1_s.abs() / most).min(1.0).sqrt();
    let mix = |from: f64, to: f64| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let value = (from + (to - from) * depth).clamp(0.0, 255.0) as u8;
        value
    };
    if growth_1_s > 0.0 {
        RGBColor(mix(253.0, 178.0), mix(219.0, 24.0), mix(199.0, 43.0))
    } else {
        RGBColor(mix(222.0, 33.0), mix(235.0, 102.0), mix(247.0, 172.0))
    }
}
