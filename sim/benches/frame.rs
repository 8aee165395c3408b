//! One picture of the cell, 500x500, on one thread: all of it, and without the noise.

use ctos::diagnostic::Source;
use divan::Bencher;
use sim::{camera::Renderer, cell::Cell};

fn main() {
    divan::main();
}

fn cell() -> Option<Cell> {
    let text = include_str!("../../configs/cell.toml");
    Cell::parse(&Source::new("cell.toml", text)).ok()
}

#[divan::bench]
fn render(bencher: Bencher) {
    let Some(cell) = cell() else { return };
    let scene = cell.start();
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 1);
    let mut number = 0;
    bencher.bench_local(|| {
        number += 1;
        renderer.render(&scene, number)
    });
}

#[divan::bench]
fn light(bencher: Bencher) {
    let Some(cell) = cell() else { return };
    let scene = cell.start();
    let mut renderer = Renderer::new(&cell, &cell.cameras[0], 1);
    bencher.bench_local(|| renderer.light(&scene)[0]);
}
