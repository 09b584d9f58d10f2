//! The frame of a page that stands alone: one style for light and dark, nothing loaded from outside.

use super::plot::escape;
pub use crate::units::{engineering, significant};

/// A page: everything it needs is inside it.
#[must_use]
pub fn page(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\">\
         <title>{}</title><style>{STYLE}</style></head>\n<body><main>{body}</main></body></html>\n",
        escape(title)
    )
}

const STYLE: &str = "
:root{--paper:#fbfaf7;--card:#fff;--ink:#1d2430;--soft:#5c6675;--rule:#e4e1d9;--grid:#ece9e2;
--before:#d1495b;--after:#1f7a8c;--floor:#8a8f98;--good:#2e7d4f;--warn:#b7791f;--accent:#274690;--tint:#eef2f8}
@media (prefers-color-scheme:dark){:root{--paper:#14171c;--card:#1b2027;--ink:#e6e9ee;--soft:#9aa4b2;
--rule:#2c333d;--grid:#262c35;--before:#ff7a85;--after:#4cc3d9;--floor:#7c8693;--good:#63c48b;--warn:#e0b050;
--accent:#8fb0ff;--tint:#202836}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,'Segoe UI','DejaVu Sans',sans-serif}
main{max-width:1100px;margin:0 auto;padding:30px 24px 60px}
h1{font-size:27px;line-height:1.22;margin:8px 0 8px;letter-spacing:-.01em;max-width:36em}
h2{font-size:13px;text-transform:uppercase;letter-spacing:.08em;color:var(--soft);margin:34px 0 10px;font-weight:650}
h3{font-size:16px;margin:0 0 2px}
p{margin:0 0 8px;max-width:66em}.soft{color:var(--soft)}.small{font-size:13px}
.badge{display:inline-block;font-size:12px;font-weight:650;letter-spacing:.06em;text-transform:uppercase;
padding:3px 10px;border-radius:99px;border:1px solid currentColor}
.missing_physics{color:var(--before)}.parameter_error{color:var(--warn)}.model_adequate{color:var(--good)}
.unexplained_mismatch{color:var(--accent)}
.card{background:var(--card);border:1px solid var(--rule);border-radius:10px;padding:14px 16px;margin:0 0 14px;
min-width:0;overflow-x:auto}
.row{display:grid;gap:14px;grid-template-columns:repeat(auto-fit,minmax(300px,1fr))}
.hero{display:grid;gap:14px;grid-template-columns:minmax(0,3fr) minmax(210px,1fr);align-items:stretch}
@media (max-width:800px){.hero{grid-template-columns:1fr}}
.numbers{display:flex;flex-direction:column;justify-content:center;gap:12px}
.big{font-size:27px;font-weight:650;line-height:1.1;letter-spacing:-.01em}
.figure{width:100%;height:auto;display:block}
.tick{font-size:11px;fill:var(--soft)}.label{font-size:12px;fill:var(--soft)}
.grid{stroke:var(--grid);stroke-width:1}.grid.zero{stroke:var(--rule);stroke-width:1.5}
.line{fill:none;stroke-width:1.6;stroke-linejoin:round}.envelope{fill:none;stroke-width:1.15}
.thin{stroke-width:1;opacity:.75}.dash{stroke-dasharray:5 3}
.before{color:var(--before)}.after{color:var(--after)}.floor{color:var(--floor)}.shade{color:var(--warn)}.accent{color:var(--accent)}
.line,.envelope{stroke:currentColor}.area{fill:currentColor;opacity:.2}.dot{fill:currentColor}
.dot.ring{fill:var(--card);stroke:currentColor;stroke-width:1.8}
.key{display:inline-flex;align-items:center;gap:6px;margin-right:16px;font-size:13px;color:var(--soft)}
.key i{width:16px;height:3px;border-radius:2px;background:currentColor;display:inline-block}
table{border-collapse:collapse;width:100%;font-size:14px}th{text-align:left;font-weight:600;color:var(--soft);
font-size:12px}th,td{padding:6px 10px 6px 0;border-bottom:1px solid var(--rule);vertical-align:middle}
tr:last-child td{border-bottom:0}td.n,th.n{text-align:right;font-variant-numeric:tabular-nums;white-space:nowrap}
.bar{height:9px;border-radius:5px;background:currentColor;min-width:2px}.track{background:var(--grid);border-radius:5px;
min-width:90px}
.equation{font-family:ui-monospace,'DejaVu Sans Mono',monospace;font-size:13.5px;background:var(--tint);
border-radius:6px;padding:7px 11px;display:inline-block;margin:4px 0 8px;overflow-wrap:anywhere}
.next{border-left:4px solid var(--accent);padding:8px 14px;background:var(--tint);border-radius:0 8px 8px 0}
.here{border-color:var(--before);box-shadow:0 0 0 1px var(--before)}
.tag{font-size:12px;color:var(--before);font-weight:650;margin-left:8px}
footer{margin-top:36px;border-top:1px solid var(--rule);padding-top:12px;color:var(--soft);font-size:12.5px}
@media print{body{background:#fff}.card{break-inside:avoid}}
";

pub(super) fn key(class: &str, text: &str) -> String {
    format!("<span class=\"key\"><i class=\"{class}\"></i>{text}</span>")
}

/// Rows of a table that the page shows: those that a model gets wrong, or misses most, come first.
pub(super) const SHOWN_ROWS: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_carry_the_prefix_of_the_shop_floor() {
        assert_eq!(engineering(1.0e-6, "m", 3), "1.00 \u{b5}m");
        assert_eq!(engineering(1.648e-4, "s", 3), "165 \u{b5}s");
        assert_eq!(engineering(3.75e6, "N/m", 3), "3.75 MN/m");
        assert_eq!(engineering(921.8, "Hz", 4), "921.8 Hz");
        assert_eq!(engineering(-5.64, "N", 3), "\u{2212}5.64 N");
        assert_eq!(engineering(0.005, "m", 3), "5.00 mm");
        assert_eq!(engineering(203.5, "N s/m", 4), "203.5 N s/m");
    }
}
