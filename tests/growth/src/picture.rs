//! All curves as one picture, in SVG: a panel for each, in double logarithm.

use std::fmt::Write as _;

use crate::curve::{Curve, memory, time};

const WIDE: f64 = 300.0;
const HIGH: f64 = 190.0;
const ROW: usize = 3;
/// Room for words around a panel, px.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = 26.0;

const STYLE: &str = "text { font: 11px ui-sans-serif, system-ui, sans-serif; fill: #5d6778; } .title { font-weight: 600; fill: #1d2430; } \
    .steep { fill: #c2352b; } .axis { stroke: #c9ccd2; fill: none; } .time { stroke: #3b5bdb; fill: none; stroke-width: 2; } \
    .memory { stroke: #d97706; fill: none; stroke-width: 1.5; stroke-dasharray: 4 3; } .points { fill: #3b5bdb; }";

/// The picture.
#[must_use]
pub fn svg(curves: &[Curve]) -> String {
    let rows = curves.len().div_ceil(ROW).max(1);
    let (width, height) = (WIDE * ROW as f64, HIGH * rows as f64 + 24.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"How costs grow with work\">\n\
         <style>{STYLE}</style>\n<rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    for (at, curve) in curves.iter().enumerate() {
        let (x, y) = (WIDE * (at % ROW) as f64, HIGH * (at / ROW) as f64);
        panel(&mut text, curve, x, y);
    }
    let y = height - 8.0;
    // Writing to a string never fails, here and below.
    let _ = writeln!(
        text,
        "<path class=\"time\" d=\"M14 {a}h24\"/><text x=\"44\" y=\"{y}\">time</text><path class=\"memory\" d=\"M90 {a}h24\"/><text x=\"120\" y=\"{y}\">memory</text>\n</svg>",
        a = y - 4.0
    );
    text
}

fn panel(text: &mut String, curve: &Curve, x: f64, y: f64) {
    let (left, top) = (x + LEFT, y + TOP);
    let (wide, high) = (WIDE - LEFT - RIGHT, HIGH - TOP - BOTTOM);
    let class = if curve.is_steep() {
        "title steep"
    } else {
        "title"
    };
    let slope = curve
        .slope()
        .map_or_else(String::new, |slope| format!(" · slope {slope:.2}"));
    let _ = writeln!(
        text,
        "<text class=\"{class}\" x=\"{}\" y=\"{}\">{}{slope}</text>\n<path class=\"axis\" d=\"M{left} {top}v{high}h{wide}\"/>",
        x + 14.0,
        y + 20.0,
        curve.what
    );
    let times = curve
        .points
        .iter()
        .map(|(size, cost)| (*size, cost.seconds));
    let bytes = curve
        .points
        .iter()
        .filter_map(|(size, cost)| Some((*size, cost.bytes?)));
    let (Some((least, _)), Some((most, _))) = (curve.points.first(), curve.points.last()) else {
        return;
    };
    let across = |size: f64| left + wide * share(size, *least, *most);
    for (class, points) in [
        ("time", times.collect::<Vec<_>>()),
        ("memory", bytes.collect()),
    ] {
        let costs = || {
            points
                .iter()
                .map(|(_, cost)| *cost)
                .filter(|cost| *cost > 0.0)
        };
        let (low, high_cost) = (
            costs().fold(f64::INFINITY, f64::min),
            costs().fold(0.0, f64::max),
        );
        if high_cost <= 0.0 {
            continue;
        }
        // A decade at least, so that noise looks as small as it is.
        let (low, high_cost) = if high_cost / low < 10.0 {
            let middle = (low * high_cost).sqrt();
            (middle / 10f64.sqrt(), middle * 10f64.sqrt())
        } else {
            (low, high_cost)
        };
        let up = |cost: f64| top + high * (1.0 - share(cost.max(low), low, high_cost));
        let line = points
            .iter()
            .enumerate()
            .fold(String::new(), |line, (at, (size, cost))| {
                let letter = if at == 0 { 'M' } else { 'L' };
                format!("{line}{letter}{:.1} {:.1}", across(*size), up(*cost))
            });
        let _ = writeln!(text, "<path class=\"{class}\" d=\"{line}\"/>");
        if class == "time" {
            for (size, cost) in &points {
                let _ = writeln!(
                    text,
                    "<circle class=\"points\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.5\"/>",
                    across(*size),
                    up(*cost)
                );
            }
        }
        let (of, at) = if class == "time" {
            (time as fn(f64) -> String, 4.0)
        } else {
            (memory as fn(f64) -> String, 17.0)
        };
        for (cost, y) in [(high_cost, top + at), (low, top + high - 13.0 + at)] {
            let _ = writeln!(
                text,
                "<text x=\"{}\" y=\"{y:.1}\" text-anchor=\"end\">{}</text>",
                left - 6.0,
                of(cost)
            );
        }
    }
    for (size, anchor) in [(least, "start"), (most, "end")] {
        let _ = writeln!(
            text,
            "<text x=\"{:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{size}</text>",
            across(*size),
            top + high + 16.0
        );
    }
}

/// Where a number is between two others, in logarithm.
fn share(number: f64, low: f64, high: f64) -> f64 {
    if high <= low {
        0.5
    } else {
        (number / low).ln() / (high / low).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curve::Cost;

    #[test]
    fn every_curve_has_a_panel_and_a_steep_one_stands_out() {
        let curve = |what, power: f64| {
            let point = |size: f64| {
                (
                    size,
                    Cost {
                        seconds: size.powf(power) * 1e-6,
                        bytes: Some(size),
                    },
                )
            };
            Curve {
                what,
                whole: true,
                points: [1.0, 10.0, 100.0].map(point).to_vec(),
                ended: None,
            }
        };
        let text = svg(&[curve("flat", 1.0), curve("steep", 2.0)]);
        assert!(
            text.contains("class=\"title\" ") && text.contains(">flat · slope 1.00<"),
            "{text}"
        );
        assert!(text.contains("class=\"title steep\" ") && text.contains(">steep · slope 2.00<"));
        assert_eq!(text.matches("<circle").count(), 6);
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
}
