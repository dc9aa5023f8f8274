//! Scratch.
use crpl_model::world_model::WorldModel;
use crpl_sitl::world::safety;
use nalgebra::*;
fn main() {
    let s = crpl_sitl::Scenario::default();
    for path in [None, std::env::args().nth(1)] {
        let model = match &path {
            None => WorldModel::embedded().unwrap(),
            Some(p) => WorldModel::load(std::path::Path::new(p)).unwrap(),
        };
        println!("{:?} {:?} {:?}", path, model.controllable(), model.uncontrollable());
        let heads = model.station_heads(&s);
        let o = Vector2::new(0.5, 0.45);
        let y = |a: &crpl_model::world_model::Affine, r| {
            let y = a.invert(r).unwrap();
            [y.x as f32, y.y as f32]
        };
        let mut worst: Vec<(f64, String)> = vec![];
        for n in 0..20000u64 {
            let f = |k: u64| ((n * 7919 + k * 104729) % 10007) as f64 / 10007.0;
            let r = Vector2::new(f(1), f(n + 2));
            let o = Vector2::new(0.12 + 0.76 * f(3 * n + 5), 0.12 + 0.76 * f(7 * n));
            let truth = safety::collision_probability(safety::clearance(r, o, s.uav_radius, 0.1), 0.0, 0.02);
            let h = f64::from(heads.collision(y(&model.probe.c, r), y(&model.probe.u, o)));
            worst.push((
                (h - truth).abs(),
                format!("{:.2?} {:.2?} {h:.4} {truth:.4}", r.as_slice(), o.as_slice()),
            ));
        }
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        println!("worst {:?}\n mean {:.5}", &worst[..6], worst.iter().map(|w| w.0).sum::<f64>() / 2e4);
        for r in [
            [0.1, 0.5],
            [0.2, 0.5],
            [0.3, 0.55],
            [0.36, 0.45],
            [0.4, 0.6],
            [0.5, 0.62],
            [0.5, 0.6],
            [0.5, 0.65],
            [0.6, 0.6],
            [0.9, 0.5],
            [0.5, 0.9],
            [0.02, 0.02],
            [0.98, 0.98],
            [0.5, 0.3],
            [0.5, 0.32],
        ] {
            let r = Vector2::from(r);
            let c = safety::clearance(r, o, s.uav_radius, 0.1);
            let truth = safety::collision_probability(c, 0.0, 0.02);
            print!(
                "{:?}: head {:.4} truth {:.4} | gain {:.2} true {:.2}; ",
                r.as_slice(),
                heads.collision(y(&model.probe.c, r), y(&model.probe.u, o)),
                truth,
                heads.log_gain(y(&model.probe.c, r), y(&model.probe.u, o)),
                crpl_sitl::world::channel::gain(r, o, 0.1, &s.channel).ln()
            );
            println!();
        }
    }
}
