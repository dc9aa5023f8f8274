//! A policy knows its world: a scenario outside it is refused, re-optimised, or flown and stamped.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::path::Path;

use tests::program::{self, Finished};

/// Runs `gcs` with the cache of policies in `folder`.
fn gcs(folder: &Path, args: &[&str]) -> Finished {
    program::run_with_cache("gcs", args, &folder.join("cache")).unwrap()
}

fn scenario(folder: &Path, text: &str) -> String {
    let path = folder.join("scenario.toml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().into()
}

/// Each changed world of the faults list, what the refusal names, and both commands that fly at once.
#[test]
fn gcs_demo_and_episodes_refuse_a_world_that_the_policy_was_not_made_for() {
    let folder = tempfile::tempdir().unwrap();
    for (text, named) in [
        ("goal = [0.85, 0.8]", "goal = [0.9, 0.5] in the policy, [0.85, 0.8] here"),
        ("start = [0.1, 0.7]", "start = [0.1, 0.5] in the policy, [0.1, 0.7] here"),
        ("[[obstacle]]\nradius = 0.2", "obstacle[0].radius = 0.1 in the policy, 0.2 here"),
        (
            "[channel]\nbase_station = [0.2, 0.9]",
            "channel.base_station = [0.5, 0.05] in the policy, [0.2, 0.9] here",
        ),
        ("[radio]\nb_dt = 1.9", "SNR that a packet needs = 1.7407 at most in the policy, 3.3028 here"),
        (
            "[disturbance]\nsigma_c = 0.02",
            "gusts' standard deviation = 0.0015 at most in the policy, 0.0060 here",
        ),
    ] {
        let file = scenario(folder.path(), text);
        let out = folder.path().join("runs");
        for command in [&["demo", "--out", out.to_str().unwrap()][..], &["episodes", "--episodes", "2"]] {
            let ended = gcs(folder.path(), &[command, &["--scenario", &file]].concat());
            assert_eq!(ended.status.code(), Some(1), "{text}: {}", ended.stderr);
            assert!(ended.stderr.contains(named), "{text}: {}", ended.stderr);
            assert_eq!(ended.stderr.trim().lines().count(), 1, "one line: {}", ended.stderr);
        }
        assert!(!out.exists(), "a refused demo leaves no folder");
    }
}

#[test]
fn gcs_episodes_with_scenario_1_and_the_policy_of_scenario_2_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let policy = program::workspace().join("model/pretrained/learned/policy_s2.safetensors");
    let args = ["episodes", "--scenario", "1", "--policy", policy.to_str().unwrap(), "--controller", "crpl"];
    let ended = gcs(folder.path(), &args);
    let named = "obstacle[0].position = [0.5, 0.45] in the policy, [0.5, 0.3] here";
    assert!(ended.status.code() == Some(1) && ended.stderr.contains(named), "{}", ended.stderr);
}

#[test]
fn gcs_sweep_over_the_obstacle_s_radius_is_refused_or_stamped() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sweep.toml");
    let text = "name = \"radius\"\naxis = \"obstacle[0].radius\"\npoints = [0.1, 0.2]\n\
                controllers = [\"crpl\"]\nepisodes = 2\n";
    std::fs::write(&file, text).unwrap();
    let out = folder.path().join("radius");
    let args = ["sweep", "--config", file.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let ended = gcs(folder.path(), &args);
    assert_eq!(ended.status.code(), Some(1));
    assert!(ended.stderr.contains("obstacle[0].radius = 0.2: no policy for scenario"), "{}", ended.stderr);
    assert!(!out.exists(), "a refused sweep leaves no folder");

    let ended = gcs(folder.path(), &[&args[..], &["--policy-mismatch", "allow"]].concat());
    let said = ended.good().unwrap();
    let stamp = "at obstacle[0].radius = 0.2 crpl flies policies of another world";
    assert!(said.contains(stamp) && !said.contains("radius = 0.1 crpl"), "{said}");
    let points = std::fs::read_to_string(out.join("points.csv")).unwrap();
    let covers: Vec<&str> = points.lines().map(|line| line.split(',').nth(4).unwrap()).collect();
    assert_eq!(covers, ["policy_covers", "true", "false"]);
    assert!(std::fs::read_to_string(out.join("sweep.toml")).unwrap().contains("[[plan.uncovered]]"));
}

#[test]
fn gcs_episodes_with_a_mismatch_allowed_says_so_in_text_and_json() {
    let folder = tempfile::tempdir().unwrap();
    let file = scenario(folder.path(), "goal = [0.85, 0.8]");
    let args = ["episodes", "--scenario", &file, "--episodes", "2", "--controller", "crpl,rcc"];
    let args = [&args[..], &["--policy-mismatch", "allow"]].concat();
    let said = gcs(folder.path(), &args).good().unwrap();
    assert_eq!(said.matches("flies a policy of another world: goal").count(), 1, "{said}");
    let json = gcs(folder.path(), &[&args[..], &["--json"]].concat()).good().unwrap();
    let crpl: serde_json::Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    assert_eq!(crpl["policy"]["differences"][0]["key"], "goal", "{json}");
}

/// A safetensors file in which the first value of a tensor is another one.
fn spoilt(file: &Path, tensor: &str, value: f32) -> Vec<u8> {
    let mut bytes = std::fs::read(file).unwrap();
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let at = 8 + length + header[tensor]["data_offsets"][0].as_u64().unwrap() as usize;
    assert_eq!(header[tensor]["dtype"], "F32");
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    bytes
}

/// N13, also under controllers that need no policy.
#[test]
fn gcs_episodes_refuses_weights_that_are_not_finite_or_absurd() {
    let folder = tempfile::tempdir().unwrap();
    let shipped = program::workspace().join("model/pretrained");
    for value in [f32::NAN, 1e38] {
        let policy = folder.path().join("policy.safetensors");
        std::fs::write(&policy, spoilt(&shipped.join("policy_s2.safetensors"), "motion.1.weight", value))
            .unwrap();
        let args = ["episodes", "--controller", "crpl", "--policy", policy.to_str().unwrap()];
        let ended = gcs(folder.path(), &args);
        let named = "tensor `motion.1.weight` has values that are not finite, or above 1e6";
        assert!(ended.status.code() == Some(1) && ended.stderr.contains(named), "{}", ended.stderr);

        let checkpoint = folder.path().join("model");
        std::fs::create_dir_all(&checkpoint).unwrap();
        for file in ["config.json", "card.md"] {
            std::fs::copy(shipped.join(file), checkpoint.join(file)).unwrap();
        }
        let model = spoilt(&shipped.join("model.safetensors"), "heads.gain.1.weight", value);
        std::fs::write(checkpoint.join("model.safetensors"), model).unwrap();
        let args = ["episodes", "--controller", "rcc", "--checkpoint", checkpoint.to_str().unwrap()];
        let ended = gcs(folder.path(), &args);
        assert!(
            ended.status.code() == Some(1) && ended.stderr.contains("heads.gain.1.weight"),
            "{}",
            ended.stderr
        );
    }
}

/// N8: γ_min is kept, and the packet's rate is not.
#[test]
fn gcs_check_counts_the_rate_that_the_packet_needs() {
    let folder = tempfile::tempdir().unwrap();
    // A packet needs an SNR of 3 there, three times γ_min; low power gives 2.8 at start and goal.
    let file = folder.path().join("narrower.toml");
    std::fs::write(&file, "[radio]\nb_dt = 2.0\n[disturbance]\nsigma_c = 0.005\n").unwrap();
    let file = file.to_str().unwrap();
    let args = ["check", "--scenario", file, "--policy-mismatch", "allow", "--episodes", "100", "--json"];
    let ended = gcs(folder.path(), &args);
    assert_eq!(ended.status.code(), Some(1), "{}", ended.stdout);
    let check: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    assert!(check["comm"]["share"].as_f64().unwrap() < 0.9, "{check}");
    assert!(check["t_out"].as_f64().unwrap() > 1.0, "{check}");
}

/// N7: intervals of no width, over flights that are one.
#[test]
fn gcs_episodes_without_gusts_says_that_it_flew_one_flight() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["episodes", "--scenario", "2", "--controller", "rcc", "--episodes", "6"];
    let said = gcs(folder.path(), &args).good().unwrap();
    assert!(said.contains("all 6 flights are the same flight") && !said.contains('['), "{said}");
    let json = gcs(folder.path(), &[&args[..], &["--json"]].concat()).good().unwrap();
    let row: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!((&row["distinct"], &row["reached_ci"][0]), (&1.into(), &0.0.into()), "{json}");
}
