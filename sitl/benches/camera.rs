//! Pictures per second of the camera, on one core. The bars are 20,000 clean ones and 3,000 hard ones.

mod rate;

use std::hint::black_box;

use crpl_sitl::camera::{CameraConfig, Film, render};
use crpl_sitl::units::Tick;
use crpl_sitl::world::World;
use crpl_sitl::{Scenario, Sim};
use nalgebra::Vector2;

/// Flights of `hard`, each with another camera.
const FLIGHTS: u64 = 100;

fn main() {
    clean();
    for name in ["clean", "texture", "noise-5", "jpeg-50", "blur", "harder"] {
        let Some(config) = CameraConfig::case(name) else { continue };
        films(name, &[Film::new(&config, 0)]);
    }
    let hard = CameraConfig::case("hard").unwrap_or_default();
    let flights: Vec<Film> = (0..FLIGHTS).map(|seed| Film::new(&hard, seed)).collect();
    films("hard, flights in turn", &flights);
    let mut seed = 0;
    let world = World::new(&Scenario::default()).poses(&Scenario::default());
    rate::rate("hard, first frames", "frames", 1, || {
        seed += 1;
        black_box(Film::new(&hard, seed).frame(Tick(0), &world));
    });
}

/// What draws the frames of a clean flight.
fn clean() {
    let scenario = Scenario::default();
    for (place, start) in [
        ("apart", Vector2::new(0.1, 0.5)),
        ("over the obstacle", Vector2::new(0.45, 0.45)),
        ("cut by the edge", Vector2::new(0.995, 0.2)),
    ] {
        // A little further each time, so that every phase between the pixels takes part.
        let mut k = 0u32;
        rate::rate(&format!("camera, {place}"), "frames", 1, || {
            k = (k + 1) % 1000;
            let r = start + Vector2::new(3.7e-6, 5.3e-6) * f64::from(k);
            black_box(render(black_box(r), scenario.obstacle().position, &scenario));
        });
    }
}

/// Frames of flights with these cameras, in turn, of bodies that move.
fn films(name: &str, films: &[Film]) {
    let mut scenario = Scenario::default();
    scenario.obstacles[0].velocity = Vector2::new(0.0125, 0.0);
    let mut poses = Sim::new(scenario.clone(), 0).world().poses(&scenario);
    poses.uav.velocity = Vector2::new(0.02, 0.01);
    let mut k = 0u64;
    rate::rate(&format!("camera {name}"), "frames", 1, || {
        k += 1;
        let film = &films[k as usize % films.len()];
        poses.uav.position.x = 0.1 + 3.7e-6 * (k % 1000) as f64;
        black_box(film.frame(Tick(k), black_box(&poses)));
    });
}
