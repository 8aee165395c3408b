//! Draws the picture of the README: what a ceiling camera sees of the calibration, and the Dispatcher's net
//! at that moment.
//!
//! ```text
//! cargo run --release -p cli --example picture -- docs/calibrate.svg
//! ```
//!
//! The simulator renders the frame, and the vision tool finds the spots in it. The net reaches the marking
//! by firing. Only the places of the net's nodes are made by hand.

mod camera;
mod net;
mod svg;

use std::{error::Error, path::PathBuf};

use svg::Svg;

/// Which of the positions the picture shows, counted from 1.
const POSITION: usize = 36;

const WIDTH: f64 = 1344.0;
const HEIGHT: f64 = 560.0;

fn main() -> Result<(), Box<dyn Error>> {
    let out = std::env::args_os().nth(1).map(PathBuf::from);
    let out = out.ok_or("usage: picture OUT.svg")?;
    let configs = PathBuf::from("configs");
    let view = camera::View::take(&configs, "ceiling_west", POSITION)?;
    let net = net::Drawing::at_fork(
        &configs.join("nets/dispatcher.net"),
        &configs.join("nets/dispatcher.layout.toml"),
    )?;
    let mut svg = Svg::new(WIDTH, HEIGHT);
    view.draw(&mut svg, (16.0, 44.0), HEIGHT - 12.0)?;
    net.draw(&mut svg, (644.0, 84.0), HEIGHT - 12.0)?;
    std::fs::write(&out, svg.finish())?;
    Ok(())
}
