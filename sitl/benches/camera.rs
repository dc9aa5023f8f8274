//! Pictures per second of the camera, on one core. The bar is 10,000.

mod rate;

use std::hint::black_box;

use crpl_sitl::Scenario;
use crpl_sitl::camera::render;
use nalgebra::Vector2;

fn main() {
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
