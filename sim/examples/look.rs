//! Takes one picture with every camera of a cell, for looking at.
//!
//! `cargo run -p sim --example look -- CELL.toml OUT_FOLDER [joint angles of the first arm in degrees]`
//!
//! With no angles all arms stand at their starts. The pictures are `OUT_FOLDER/NAME.png`.

use std::{error::Error, fs::File, io::BufWriter, path::PathBuf};

use sim::{camera::Renderer, cell::Cell};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: look CELL.toml OUT_FOLDER [joint angles of the first arm in degrees]";
    let cell = Cell::read(&PathBuf::from(arguments.next().ok_or(usage)?))?;
    let folder = PathBuf::from(arguments.next().ok_or(usage)?);
    let angles: Vec<f64> = arguments
        .map(|angle| angle.parse().map(f64::to_radians))
        .collect::<Result<_, _>>()?;
    let mut joints: Vec<&[f64]> = cell.arms.iter().map(|arm| arm.start.as_slice()).collect();
    match joints.first_mut() {
        Some(first) if !angles.is_empty() => {
            if angles.len() != first.len() {
                return Err(usage.into());
            }
            *first = &angles;
        }
        _ => {}
    }
    std::fs::create_dir_all(&folder)?;
    let scene = cell.scene(&joints);
    for camera in &cell.cameras {
        let mut renderer = Renderer::new(&cell, camera, 1);
        let pixels = renderer.render(&scene, 0);
        let path = folder.join(format!("{}.png", camera.truth.name));
        let file = BufWriter::new(File::create(path)?);
        vss::png::write(file, camera.truth.width, camera.truth.height, &pixels)?;
    }
    Ok(())
}
