//! Pictures as SVG text: axes with round ticks, lines, envelopes, bands and bars.
//!
//! Colours are CSS classes (`before`, `after`, `floor`, ...), so that a page decides how they look in
//! light and in dark. Long series are drawn as the envelope of each pixel column: nothing that stands
//! out is lost, and a picture stays small.

use std::fmt::Write as _;

/// Room around the plot area: left, right, top, bottom, in pixels.
const ROOM: [f64; 4] = [58.0, 14.0, 12.0, 40.0];

/// One axis of a figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Name with its unit.
    pub label: String,
    /// Lower and upper end.
    pub range: [f64; 2],
    /// Logarithmic.
    pub log: bool,
}

impl Axis {
    /// A linear axis.
    #[must_use]
    pub fn linear(label: &str, range: [f64; 2]) -> Self {
        Self { label: label.to_owned(), range, log: false }
    }

    /// A logarithmic axis; both ends above zero.
    #[must_use]
    pub fn log(label: &str, range: [f64; 2]) -> Self {
        Self { label: label.to_owned(), range, log: true }
    }

    /// Share of the axis at `value`, 0 at its lower end.
    fn share(&self, value: f64) -> f64 {
        let [a, b] = self.range;
        if self.log { (value.max(1.0e-300) / a).ln() / (b / a).ln() } else { (value - a) / (b - a) }
    }

    /// Round values inside the axis: 1, 2 or 5 times a power of ten apart (decades where logarithmic).
    fn ticks(&self) -> Vec<f64> {
        let [a, b] = self.range;
        if self.log {
            return log_ticks(a, b);
        }
        let span = b - a;
        if !(span.is_finite() && span > 0.0) {
            return vec![a];
        }
        let raw = span / 5.0;
        let power = 10.0_f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw).unwrap_or(raw);
        let first = (a / step).ceil() as i64;
        let last = (b / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

fn log_ticks(a: f64, b: f64) -> Vec<f64> {
    let decades = (a.log10().floor() as i32)..=(b.log10().ceil() as i32);
    let dense = (b / a).log10() < 2.5;
    let steps: &[f64] = if dense { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let all = decades.flat_map(|d| steps.iter().map(move |m| m * 10.0_f64.powi(d)));
    all.filter(|v| (a * 0.999..=b * 1.001).contains(v)).collect()
}

/// What is drawn, in order.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// A line through points; a NaN interrupts it.
    Line {
        /// CSS class.
        class: &'static str,
        /// Points.
        points: Vec<[f64; 2]>,
    },
    /// A long series as the envelope of each pixel column.
    Envelope {
        /// CSS class.
        class: &'static str,
        /// Points, x rising.
        points: Vec<[f64; 2]>,
    },
    /// The area between two lines.
    Area {
        /// CSS class.
        class: &'static str,
        /// x, lower, upper.
        points: Vec<[f64; 3]>,
    },
    /// A horizontal band over the whole width.
    Band {
        /// CSS class.
        class: &'static str,
        /// Lower and upper end.
        y: [f64; 2],
    },
    /// Filled rectangles.
    Cells {
        /// CSS class.
        class: &'static str,
        /// Lower and upper x, lower and upper y.
        cells: Vec<[f64; 4]>,
    },
    /// Points as small discs.
    Dots {
        /// CSS class.
        class: &'static str,
        /// Points.
        points: Vec<[f64; 2]>,
    },
}

/// A figure: two axes and what is drawn between them.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Width and height in pixels.
    pub size: [f64; 2],
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// What is drawn, first below.
    pub marks: Vec<Mark>,
    /// Said to who cannot see it.
    pub title: String,
}

impl Figure {
    /// The figure as an `<svg>` element.
    #[must_use]
    pub fn svg(&self) -> String {
        let [w, h] = self.size;
        let mut out = String::new();
        let _ = write!(
            out,
            "<svg class=\"figure\" viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{}\">",
            escape(&self.title)
        );
        self.grid(&mut out);
        let [l, r, t, b] = ROOM;
        let (iw, ih) = (w - l - r, h - t - b);
        let _ = write!(out, "<svg x=\"{l}\" y=\"{t}\" width=\"{iw}\" height=\"{ih}\" overflow=\"hidden\">");
        for mark in &self.marks {
            self.mark(&mut out, mark);
        }
        out.push_str("</svg></svg>");
        out
    }

    /// Position inside the plot area, pixels from its upper left corner.
    fn place(&self, p: [f64; 2]) -> [f64; 2] {
        let [l, r, t, b] = ROOM;
        let [w, h] = [self.size[0] - l - r, self.size[1] - t - b];
        let far = |v: f64| v.clamp(-3.0, 4.0);
        [w * far(self.x.share(p[0])), h * (1.0 - far(self.y.share(p[1])))]
    }

    fn grid(&self, out: &mut String) {
        let [l, r, t, b] = ROOM;
        let [w, h] = self.size;
        for v in self.x.ticks() {
            let x = l + self.place([v, self.y.range[0]])[0];
            let (y1, y2, yt) = (t, h - b, h - b + 15.0);
            let _ = write!(out, "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{y1}\" y2=\"{y2}\"/>");
            let text = tick_text(v, &self.x);
            let _ = write!(
                out,
                "<text class=\"tick\" x=\"{x:.1}\" y=\"{yt}\" text-anchor=\"middle\">{text}</text>"
            );
        }
        for v in self.y.ticks() {
            let y = t + self.place([self.x.range[0], v])[1];
            let (x1, x2, xt) = (l, w - r, l - 7.0);
            let zero = if v == 0.0 && !self.y.log { " zero" } else { "" };
            let _ = write!(
                out,
                "<line class=\"grid{zero}\" x1=\"{x1}\" x2=\"{x2}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>"
            );
            let text = tick_text(v, &self.y);
            let yt = y + 3.5;
            let _ = write!(
                out,
                "<text class=\"tick\" x=\"{xt}\" y=\"{yt:.1}\" text-anchor=\"end\">{text}</text>"
            );
        }
        let (cx, by) = (l + (w - l - r) / 2.0, h - 6.0);
        let _ = write!(
            out,
            "<text class=\"label\" x=\"{cx:.1}\" y=\"{by}\" text-anchor=\"middle\">{}</text>",
            escape(&self.x.label)
        );
        let cy = t + (h - t - b) / 2.0;
        let _ = write!(
            out,
            "<text class=\"label\" transform=\"translate(13 {cy:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escape(&self.y.label)
        );
    }

    fn mark(&self, out: &mut String, mark: &Mark) {
        match mark {
            Mark::Line { class, points } => {
                put_path(out, &format!("line {class}"), &self.path(points));
            }
            Mark::Envelope { class, points } => self.envelope(out, class, points),
            Mark::Area { class, points } => {
                let upper: Vec<[f64; 2]> = points.iter().map(|p| [p[0], p[2]]).collect();
                let lower: Vec<[f64; 2]> = points.iter().rev().map(|p| [p[0], p[1]]).collect();
                let (upper, tail) = (self.path(&upper), self.path(&lower).replacen('M', "L", 1));
                let closed = if upper.is_empty() { upper } else { format!("{upper}{tail}Z") };
                put_path(out, &format!("area {class}"), &closed);
            }
            Mark::Band { class, y } => {
                let top = self.place([self.x.range[0], y[1]])[1];
                let low = self.place([self.x.range[0], y[0]])[1];
                let height = (low - top).max(1.0);
                let _ = write!(
                    out,
                    "<rect class=\"area {class}\" x=\"0\" y=\"{top:.1}\" width=\"100%\" height=\"{height:.1}\"/>"
                );
            }
            Mark::Cells { class, cells } => {
                let mut d = String::new();
                for [x1, x2, y1, y2] in cells {
                    let ([left, low], [right, top]) = (self.place([*x1, *y1]), self.place([*x2, *y2]));
                    let _ = write!(d, "M{left:.1} {low:.1}H{right:.1}V{top:.1}H{left:.1}Z");
                }
                put_path(out, &format!("area {class}"), &d);
            }
            Mark::Dots { class, points } => {
                for p in points.iter().filter(|p| p[0].is_finite() && p[1].is_finite()) {
                    let [x, y] = self.place(*p);
                    let _ =
                        write!(out, "<circle class=\"dot {class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>");
                }
            }
        }
    }

    fn path(&self, points: &[[f64; 2]]) -> String {
        let mut d = String::new();
        let mut pen_down = false;
        for p in points {
            if !(p[0].is_finite() && p[1].is_finite()) {
                pen_down = false;
                continue;
            }
            let [x, y] = self.place(*p);
            let _ = write!(d, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
            pen_down = true;
        }
        d
    }

    /// Lowest and highest value of each pixel column; a plain line where points are few.
    fn envelope(&self, out: &mut String, class: &str, points: &[[f64; 2]]) {
        let columns = (self.size[0] - ROOM[0] - ROOM[1]).max(1.0) as usize;
        if points.len() < 2 * columns {
            put_path(out, &format!("line {class}"), &self.path(points));
            return;
        }
        let mut extent: Vec<Option<[f64; 2]>> = vec![None; columns];
        for p in points.iter().filter(|p| p[1].is_finite()) {
            let share = self.x.share(p[0]);
            if !(0.0..1.0).contains(&share) {
                continue;
            }
            let slot = &mut extent[((share * columns as f64) as usize).min(columns - 1)];
            *slot = Some(slot.map_or([p[1], p[1]], |e| [e[0].min(p[1]), e[1].max(p[1])]));
        }
        let mut d = String::new();
        for (k, e) in extent.iter().enumerate() {
            let Some([low, high]) = e else { continue };
            let x = k as f64 + 0.5;
            let y1 = self.place([self.x.range[0], *low])[1];
            let y2 = self.place([self.x.range[0], *high])[1].min(y1 - 0.8);
            let _ = write!(d, "M{x:.1} {y1:.1}V{y2:.1}");
        }
        put_path(out, &format!("envelope {class}"), &d);
    }
}

/// A path; nothing where there is none to draw.
fn put_path(out: &mut String, class: &str, d: &str) {
    if !d.is_empty() {
        let _ = write!(out, "<path class=\"{class}\" d=\"{d}\"/>");
    }
}

fn tick_text(value: f64, axis: &Axis) -> String {
    if axis.log {
        if (1.0e4..1.0e7).contains(&value) {
            return format!("{}k", trimmed(value / 1000.0, 0));
        }
        return if (1.0e-3..1.0e5).contains(&value) { trimmed(value, 6) } else { format!("{value:.0e}") };
    }
    let step = (axis.range[1] - axis.range[0]) / 5.0;
    if value.abs() >= 1.0e4 {
        return format!("{}k", trimmed(value / 1000.0, 1)).replace('-', "\u{2212}");
    }
    let decimals = (-(step.abs().max(1.0e-12)).log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.decimals$}");
    let text =
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    if text == "-0" { "0".to_owned() } else { text.replace('-', "\u{2212}") }
}

fn trimmed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A range around `values` with a little air; symmetric around zero where `symmetric`.
///
/// The most extreme 0.2 % are left out, so that a single spike does not squeeze everything else.
#[must_use]
pub fn range_of(values: &mut [f64], symmetric: bool) -> [f64; 2] {
    let finite = {
        values.sort_by(f64::total_cmp);
        let n = values.iter().rposition(|v| v.is_finite()).map_or(0, |k| k + 1);
        let first = values.iter().position(|v| v.is_finite()).unwrap_or(0);
        &values[first.min(n)..n]
    };
    let Some(last) = finite.len().checked_sub(1) else { return [-1.0, 1.0] };
    let cut = (finite.len() as f64 * 0.001) as usize;
    let (low, high) = (finite[cut], finite[last - cut]);
    if symmetric {
        let reach = low.abs().max(high.abs()).max(1.0e-12) * 1.08;
        return [-reach, reach];
    }
    let air = 0.06 * (high - low).max(1.0e-12 + 1.0e-6 * high.abs());
    [low - air, high + air]
}

/// Text that is safe inside an element or an attribute.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(Axis::linear("", [-1.3, 4.2]).ticks(), vec![0.0, 2.0, 4.0]);
        assert_eq!(Axis::log("", [0.5, 300.0]).ticks(), vec![1.0, 10.0, 100.0]);
        assert_eq!(tick_text(-2.0e4, &Axis::linear("", [-3.0e4, 3.0e4])), "\u{2212}20k");
        assert_eq!(tick_text(-0.05, &Axis::linear("", [-0.1, 0.1])), "\u{2212}0.05");
    }

    #[test]
    fn a_spike_survives_in_the_envelope() {
        let mut points: Vec<[f64; 2]> = (0..100_000).map(|k| [f64::from(k), 0.0]).collect();
        points[40_000][1] = 5.0;
        let figure = Figure {
            size: [400.0, 200.0],
            x: Axis::linear("t", [0.0, 100_000.0]),
            y: Axis::linear("y", [-1.0, 5.0]),
            marks: vec![Mark::Envelope { class: "before", points }],
            title: "spike".to_owned(),
        };
        assert!(figure.svg().contains("V0.0"), "the spike reaches the upper edge");
    }

    #[test]
    fn nothing_that_is_markup_gets_through() {
        assert_eq!(escape("<b a='1'>&\"\n"), "&lt;b a=&#39;1&#39;&gt;&amp;&quot; ");
    }

    #[test]
    fn one_spike_does_not_squeeze_the_range() {
        let mut values: Vec<f64> = (0..10_000).map(|k| (f64::from(k) * 0.01).sin()).collect();
        values.push(1.0e6);
        assert!(range_of(&mut values, true)[1] < 1.2);
    }
}
