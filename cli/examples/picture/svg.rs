//! The few shapes that the picture needs, as SVG text.

use std::fmt::{Display, Write as _};

/// Colours, for a light background.
pub const INK: &str = "#1f2933";
pub const QUIET: &str = "#7b8794";
pub const AMBER: &str = "#f59e0b";
pub const RED: &str = "#c2410c";

/// A drawing under construction.
pub struct Svg {
    text: String,
}

impl Svg {
    pub fn new(width: f64, height: f64) -> Self {
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"'Helvetica Neue', Helvetica, Arial, 'DejaVu Sans', sans-serif\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
        );
        for (name, colour) in [("ink", INK), ("red", RED)] {
            let _ = writeln!(
                text,
                "<marker id=\"{name}\" viewBox=\"0 0 10 10\" refX=\"9\" refY=\"5\" markerWidth=\"7\" \
                 markerHeight=\"7\" orient=\"auto\"><path d=\"M0 1 10 5 0 9z\" fill=\"{colour}\"/></marker>"
            );
        }
        Self { text }
    }

    /// Adds an element `name` with `attributes` as they stand in SVG.
    pub fn element(&mut self, name: &str, attributes: impl Display) {
        let _ = writeln!(self.text, "<{name} {attributes}/>");
    }

    pub fn circle(&mut self, (x, y): (f64, f64), radius: f64, attributes: &str) {
        self.element(
            "circle",
            format_args!("cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" {attributes}"),
        );
    }

    /// A line through `points`, corners rounded.
    pub fn path(&mut self, points: &[(f64, f64)], attributes: &str) {
        let mut d = String::new();
        for (index, &(x, y)) in points.iter().enumerate() {
            let around = (index > 0)
                .then(|| points.get(index - 1).zip(points.get(index + 1)))
                .flatten();
            let _ = match (index, around) {
                (0, _) => write!(d, "M{x:.1} {y:.1}"),
                (_, Some((&before, &after))) => {
                    let (bx, by) = towards((x, y), before, 12.0);
                    let (ax, ay) = towards((x, y), after, 12.0);
                    write!(d, "L{bx:.1} {by:.1}Q{x:.1} {y:.1} {ax:.1} {ay:.1}")
                }
                _ => write!(d, "L{x:.1} {y:.1}"),
            };
        }
        self.element("path", format_args!("d=\"{d}\" fill=\"none\" {attributes}"));
    }

    pub fn label(&mut self, (x, y): (f64, f64), attributes: &str, text: &str) {
        let _ = writeln!(
            self.text,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" {attributes}>{text}</text>"
        );
    }

    pub fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }
}

/// The point `distance` from `from` on the way to `to`.
pub fn towards(from: (f64, f64), to: (f64, f64), distance: f64) -> (f64, f64) {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1e-9);
    (
        from.0 + dx / length * distance,
        from.1 + dy / length * distance,
    )
}

/// A line of explanation.
pub fn note(svg: &mut Svg, at: (f64, f64), text: &str) {
    svg.label(at, &format!("font-size=\"15\" fill=\"{QUIET}\""), text);
}
