//! The left half: a frame of a ceiling camera, and the spots of all positions.

use std::{error::Error, path::Path};

use base64::Engine as _;
use mcs::model::{Placement, built_in, file::Inertias, inverse::ClosedForm};
use png::{ColorType, Compression, Encoder, Filter};
use sim::{camera::Renderer, cell::Cell};
use vss::{
    frame::Frame,
    spot::{Spot, SpotOptions, find_spot},
};

use crate::svg::{AMBER, INK, Svg, note};

/// Side of the frame in the picture; one unit is one pixel of the camera.
const SIDE: f64 = 480.0;

/// The cell is dim so that the spot stands out; people see more when grey levels are multiplied.
const BRIGHTER: f64 = 2.6;

/// Grey levels are rounded to multiples of this (16 levels), which makes the file a third.
const GREY_STEP: f64 = 17.0;

/// What the camera saw.
pub struct View {
    camera: String,
    frame: Frame,
    position: usize,
    /// The spot at each position, where one was found.
    spots: Vec<Option<Spot>>,
}

impl View {
    /// Puts the arm at every position of the calibration and looks; keeps the frame of one.
    pub fn take(configs: &Path, camera: &str, position: usize) -> Result<Self, Box<dyn Error>> {
        let cell = Cell::read(&configs.join("cell.toml"))?;
        let positions = coordinators::positions::read(&configs.join("positions.csv"))?;
        let mut renderer = Renderer::new(&cell, cell.camera(camera).map_err(|f| f.to_string())?, 1);
        let first = cell.arms.first().zip(cell.lamps.first());
        let (first, lamp) = first.ok_or("the cell has no arm or no lamp")?;
        let (lamp, mut near) = (lamp.offset, first.start.as_slice().try_into()?);
        let arm = built_in::model("puma560", Inertias::Identified).ok_or("no such arm")??;
        let arm = arm.with_tool(&Placement::shifted(lamp.x, lamp.y, lamp.z));
        let arm = ClosedForm::of(&arm, arm.tip()).ok_or("the arm has no closed form")?;
        let (mut spots, mut kept) = (Vec::new(), None);
        for (number, goal) in (1..).zip(&positions) {
            let solutions = arm.inverse(&Placement::from(&goal.pose), &near)?;
            near = solutions.nearest_within(arm.limits(), &near, None)?.joints;
            let pixels = renderer.render(&cell.scene(&[&near]), number);
            let frame = Frame::grey8(renderer.truth().width, renderer.truth().height, pixels);
            spots.push(find_spot(&frame, &SpotOptions::default()).ok());
            if spots.len() == position {
                kept = Some(frame);
            }
        }
        Ok(Self {
            camera: camera.to_owned(),
            frame: kept.ok_or("there is no such position")?,
            position,
            spots,
        })
    }

    /// Draws it with its upper left corner at `(x, y)`, and a note at `bottom`.
    pub fn draw(
        &self,
        svg: &mut Svg,
        (x, y): (f64, f64),
        bottom: f64,
    ) -> Result<(), Box<dyn Error>> {
        let here = self.spots.get(self.position - 1).copied().flatten();
        let here = here.ok_or("no spot was found at the position to be shown")?;
        let scale = SIDE / self.frame.width as f64;
        let at = |spot: &Spot| (x + (spot.u + 0.5) * scale, y + (spot.v + 0.5) * scale);
        let head = format!(
            "{}, position {} of {}",
            self.camera,
            self.position,
            self.spots.len()
        );
        svg.label(
            (x, y - 16.0),
            &format!("font-size=\"19\" fill=\"{INK}\""),
            &head,
        );
        svg.element(
            "image",
            format_args!(
                "x=\"{x}\" y=\"{y}\" width=\"{SIDE}\" height=\"{SIDE}\" \
                 href=\"data:image/png;base64,{}\"",
                self.png()?
            ),
        );
        let seen: Vec<(f64, f64)> = self.spots.iter().flatten().map(at).collect();
        let points: Vec<String> = seen.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        svg.element(
            "polyline",
            format_args!(
                "points=\"{}\" fill=\"none\" stroke=\"{AMBER}\" stroke-opacity=\"0.35\"",
                points.join(" ")
            ),
        );
        for (index, spot) in self.spots.iter().enumerate() {
            let Some(spot) = spot else { continue };
            let done = index + 1 < self.position;
            let fill = if done { AMBER } else { "none" };
            svg.circle(
                at(spot),
                2.6,
                &format!("fill=\"{fill}\" stroke=\"{AMBER}\" stroke-width=\"1.1\""),
            );
        }
        mark(svg, at(&here), &here, x + SIDE);
        let text = "spots found: filled so far, open still to come";
        note(svg, (x, bottom), text);
        Ok(())
    }

    fn png(&self) -> Result<String, Box<dyn Error>> {
        let grey = |value: &u8| {
            let bright = f64::from(*value) * BRIGHTER;
            ((bright / GREY_STEP).round() * GREY_STEP).min(255.0) as u8
        };
        let pixels: Vec<u8> = self.frame.pixels.iter().map(grey).collect();
        let (width, height) = (
            u32::try_from(self.frame.width)?,
            u32::try_from(self.frame.height)?,
        );
        let mut bytes = Vec::new();
        // Noise does not follow from its neighbours, so no filter compresses best.
        let mut encoder = Encoder::new(&mut bytes, width, height);
        encoder.set_color(ColorType::Grayscale);
        encoder.set_compression(Compression::High);
        encoder.set_filter(Filter::NoFilter);
        encoder.write_header()?.write_image_data(&pixels)?;
        Ok(base64::engine::general_purpose::STANDARD.encode(bytes))
    }
}

/// The mark around a found spot, and what was measured.
fn mark(svg: &mut Svg, (x, y): (f64, f64), spot: &Spot, right: f64) {
    let stroke = "stroke=\"#ffffff\" stroke-width=\"1.8\"";
    svg.circle((x, y), 13.0, &format!("fill=\"none\" {stroke}"));
    for (dx, dy) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
        let ends = [(x + 9.0 * dx, y + 9.0 * dy), (x + 20.0 * dx, y + 20.0 * dy)];
        svg.path(&ends, stroke);
    }
    let text = format!("u = {:.2} px, v = {:.2} px", spot.u, spot.v);
    let (anchor, side) = if x + 260.0 < right {
        ("start", 26.0)
    } else {
        ("end", -26.0)
    };
    svg.label(
        (x + side, y - 8.0),
        &format!(
            "font-size=\"16\" fill=\"#ffffff\" text-anchor=\"{anchor}\" paint-order=\"stroke\" \
             stroke=\"#1f2933\" stroke-width=\"3\""
        ),
        &text,
    );
}
