//! Pictures per second of the camera, on one core. The bar is 10,000.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Vector2;
use sitl::Scenario;
use sitl::camera::render;

fn camera(c: &mut Criterion) {
    let scenario = Scenario::default();
    let obstacle = scenario.obstacle.position;
    let mut group = c.benchmark_group("camera");
    group.throughput(Throughput::Elements(1));
    for (place, start) in [
        ("apart", Vector2::new(0.1, 0.5)),
        ("over the obstacle", Vector2::new(0.45, 0.45)),
        ("cut by the edge", Vector2::new(0.995, 0.2)),
    ] {
        // A little further each time, so that every phase between the pixels takes part.
        let mut k = 0u32;
        group.bench_function(place, |b| {
            b.iter(|| {
                k = (k + 1) % 1000;
                let r = start + Vector2::new(3.7e-6, 5.3e-6) * f64::from(k);
                render(std::hint::black_box(r), obstacle, &scenario)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, camera);
criterion_main!(benches);
