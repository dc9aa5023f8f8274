//! Scratch driver of the learned encoder.
use crpl_model::encoder::votes::{Activations, VoteEncoder};
use crpl_model::training::learned::{self, LearnedConfig};
use crpl_model::world_model::recording::{Recording, Truth};
use crpl_sitl::world::noise::Noise;
use std::path::Path;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = Path::new(&args[1]);
    let mut config: LearnedConfig = toml::from_str(&std::fs::read_to_string(&args[2]).unwrap()).unwrap();
    let seed: u64 = args[3].parse().unwrap();
    let out = Path::new(&args[4]);
    let recording = Recording::open(dir, None).unwrap();
    let steps = config.steps;
    let bar = indicatif::ProgressBar::hidden();
    let start = std::time::Instant::now();
    // monitor every 250 steps through the saved progress: run in segments
    std::fs::create_dir_all(out).unwrap();
    config.save_every = 250;
    let init = args.get(5).map(|p| learned::load_encoder(Path::new(p)).unwrap());
    let all = recording.episodes().len();
    let monitor = |w: &crpl_model::encoder::votes::VoteWeights| {
        let encoder = VoteEncoder::new(w.clone());
        let mut act = Activations::default();
        let mut rows = [Vec::new(), Vec::new()];
        for e in all - config.held_out..all {
            let truth = Truth::load(dir, e).unwrap();
            for k in (0..recording.episodes()[e].len()).step_by(10) {
                act.set_frame(&recording.episodes()[e].frame(k).unwrap());
                let v = encoder.forward(&mut act);
                for (b, t) in [truth.uav[k], truth.obstacle[k]].into_iter().enumerate() {
                    rows[b].push([v.p[b][0] - 100.0 * t.x as f32, v.p[b][1] - 100.0 * t.y as f32]);
                }
            }
        }
        for (name, rows) in ["c", "u"].iter().zip(&rows) {
            let med = |axis: usize| {
                let mut v: Vec<f32> = rows.iter().map(|r| r[axis]).collect();
                v.sort_by(f32::total_cmp);
                v[v.len() / 2]
            };
            let m = [med(0), med(1)];
            let mut e: Vec<f32> = rows.iter().map(|r| (r[0] - m[0]).abs() + (r[1] - m[1]).abs()).collect();
            e.sort_by(f32::total_cmp);
            print!(
                "  {name} offset {:+.2} {:+.2} p50 {:.3} p90 {:.3} lost {:.3}",
                m[0],
                m[1],
                e[e.len() / 2],
                e[e.len() * 9 / 10],
                e.iter().filter(|e| **e > 3.0).count() as f64 / e.len() as f64
            );
        }
        println!();
    };
    tracing_subscriber::fmt().with_max_level(tracing::Level::DEBUG).init();
    let w = learned::train_watched(
        &recording,
        &config,
        init.as_ref(),
        &Noise::new(seed),
        Some(out),
        &bar,
        &mut |step, w| {
            if step % 500 == 0 || step == steps {
                print!("{step} {:.0} s", start.elapsed().as_secs_f64());
                monitor(w);
            }
        },
    )
    .unwrap();
    learned::save_encoder(&w, &out.join("encoder.safetensors")).unwrap();
}
