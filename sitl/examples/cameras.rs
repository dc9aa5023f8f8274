//! Makes a picture sheet of the cameras: `cargo run --release -p crpl-sitl --example cameras -- docs/cameras.png`.
//!
//! Rows: one effect each, twice; then eight flights of `hard`, and eight of `harder`.

use std::fs::File;
use std::io::BufWriter;

use anyhow::{Context, Result};
use crpl_sitl::Scenario;
use crpl_sitl::camera::{Body, CHANNELS, CameraConfig, Film, Frame, Poses, SIDE};
use crpl_sitl::units::Tick;
use nalgebra::Vector2;

const COLUMNS: usize = 8;
/// One camera each; all flights but those of the last two rows have the same seed.
const ROWS: [[&str; COLUMNS]; 4] = [
    ["clean", "mixed", "family", "any", "noise-5", "drift", "shade", "jpeg-50"],
    [
        "blur",
        "shake",
        "distractors",
        "texture",
        "texture-drift",
        "texture-any",
        "texture-distractors",
        "texture-cut",
    ],
    ["hard"; COLUMNS],
    ["harder"; COLUMNS],
];
const SEED: u64 = 7;
/// Pixels of the sheet along a pixel of a frame, and between frames.
const ZOOM: usize = 2;
const GAP: usize = 4;

fn main() -> Result<()> {
    let path = std::env::args().nth(1).context("the file to write, such as docs/cameras.png")?;
    let frames = ROWS.iter().enumerate().flat_map(|(row, names)| {
        names.iter().enumerate().map(move |(column, name)| frame(name, row, column))
    });
    let frames: Vec<Frame> = frames.collect::<Result<_>>()?;
    let [width, height] = [COLUMNS, ROWS.len()].map(|count| count * (SIDE * ZOOM + GAP) - GAP);
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let bytes: Vec<u8> = pixels.flat_map(|(x, y)| pixel(&frames, x, y)).collect();
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(&path)?), width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(&bytes).with_context(|| format!("writing {path}"))
}

/// The frame at a place of the sheet.
fn frame(name: &str, row: usize, column: usize) -> Result<Frame> {
    let config = CameraConfig::named(name)?;
    let several = row >= 2;
    let seed = if several { column as u64 } else { SEED };
    Ok(Film::new(&config, seed).frame(Tick(10), &poses(name.ends_with("cut"), several.then_some(column))))
}

/// The UAV on its way past the obstacle, or half over the edge; in a row of flights further on in each.
fn poses(cut: bool, flight: Option<usize>) -> Poses {
    let scenario = Scenario::default();
    let place = 0.15 + 0.09 * flight.unwrap_or(1) as f64;
    let position = if cut { Vector2::new(0.99, 0.5) } else { Vector2::new(place, 0.62) };
    let obstacle =
        Body { position: Vector2::new(0.5, 0.45), velocity: Vector2::new(0.0, 0.0125), radius: 0.1 };
    let uav = Body { position, velocity: Vector2::new(0.035, 0.0), radius: scenario.uav_radius };
    Poses { uav, obstacles: [obstacle].into() }
}

/// A pixel of the sheet: white between the frames.
fn pixel(frames: &[Frame], x: usize, y: usize) -> [u8; CHANNELS] {
    let cell = SIDE * ZOOM + GAP;
    let (column, row) = (x / cell, y / cell);
    let (x, y) = (x % cell / ZOOM, y % cell / ZOOM);
    if x < SIDE && y < SIDE { frames[row * COLUMNS + column].pixel(x, y) } else { [255; CHANNELS] }
}
