//! Scratch.
use crpl_model::world_model::exploration::*;
use crpl_sitl::camera::CameraConfig;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let mut config = ExplorationConfig { episodes: args[2].parse().unwrap(), ..Default::default() };
    if let Some(list) = args.get(4) {
        config.cameras = list.split(',').map(|p| { let (n, s) = p.split_once(':').unwrap(); (n.to_string(), s.parse().unwrap()) }).collect();
    }
    let cameras: Vec<CameraConfig> = config.cameras.iter().map(|(n, _)| CameraConfig::named(n).unwrap()).collect();
    let start = std::time::Instant::now();
    collect(&config, &cameras, &crpl_sitl::Scenario::default(), args[3].parse().unwrap(), (std::path::Path::new(&args[1]), Default::default()), || {}).unwrap();
    println!("{:.1} s", start.elapsed().as_secs_f64());
}
