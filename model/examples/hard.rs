//! Scratch: the hard table of a bare encoder.
use crpl_model::encoder::frame_encoder::*;
use crpl_model::encoder::probe::*;
use crpl_model::encoder::votes::*;
use crpl_model::world_model::WorldModel;
use crpl_sitl::world::noise::Noise;
use nalgebra::*;
fn main() {
    let mut model = WorldModel::embedded().unwrap();
    if let Some(path) = std::env::args().nth(1) {
        let w = crpl_model::training::learned::load_encoder(std::path::Path::new(&path)).unwrap();
        model.encoder = FrameEncoder::Learned(LearnedSight { encoder: VoteEncoder::new(w), noise: Default::default() });
        let a = Affine { matrix: Matrix2::identity() / model.scale, offset: Vector2::repeat(0.5) };
        model.probe = Probe { c: a, u: a };
    }
    let report = crpl_model::evaluation::hard::measure(&model, 600, &crpl_sitl::Scenario::default(), &Noise::new(77));
    print!("{}", report.table());
    let frame = crpl_sitl::camera::render(Vector2::new(0.3, 0.4), Vector2::new(0.7, 0.6), &crpl_sitl::Scenario::default());
    let t = std::time::Instant::now();
    for _ in 0..200 { std::hint::black_box(model.encode(std::hint::black_box(&frame))); }
    println!("{:.3} ms a frame", t.elapsed().as_secs_f64() * 5.0);
}
