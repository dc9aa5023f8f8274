//! Examples below the help of each command.

/// By command.
pub const EXAMPLES: &[(&str, &[&str])] = &[
    (
        "demo",
        &[
            "gcs demo --watch",
            "gcs demo --controller crpl,rcc,ucc",
            "gcs demo --scenario elsewhere --optimise --seed 7",
        ],
    ),
    (
        "fly",
        &[
            "gcs fly --connect udpout:127.0.0.1:14550 --controller rcc",
            "gcs fly --connect udpin:0.0.0.0:14550 --vehicle ardupilot --dry-run",
            "gcs fly --connect tcpout:uav:5760 --vehicle px4 --watch --buildings b.geojson",
        ],
    ),
    (
        "record",
        &[
            "gcs record --connect udpout:127.0.0.1:14550 --episodes 40 --out runs/hard",
            "gcs record --connect udpout:127.0.0.1:14550 --out runs/hard --resume --watch",
        ],
    ),
    (
        "episodes",
        &[
            "gcs episodes --controller crpl,rcc --episodes 20",
            "gcs episodes --controller \"exec:python3 pid.py\"",
        ],
    ),
    (
        "fleet",
        &["gcs fleet --vehicles 1,4 --scheduler tdma", "gcs fleet --vehicles 8 --drawn --out runs/fleet"],
    ),
    (
        "optimise",
        &["gcs optimise --scenario mine.toml --out runs/policy", "gcs optimise --random 20 --seed 7"],
    ),
    ("check", &["gcs check --scenario gusty", "gcs check --policy runs/policy --scenario mine.toml"]),
    ("bound", &["gcs bound --scenario demo --controller crpl,rcc --episodes 50"]),
    ("sensitivity", &["gcs sensitivity --draws 20 --episodes 20", "gcs sensitivity --table"]),
    ("tune", &["gcs tune --controller rcc --scenario mine.toml"]),
    (
        "sweep",
        &[
            "gcs sweep --config configs/sweep_bandwidth.toml --episodes 8",
            "gcs sweep --config configs/sweep_bandwidth.toml --shard 1/4",
            "gcs sweep --config configs/sweep_bandwidth.toml --watch",
        ],
    ),
    (
        "scenario",
        &[
            "gcs scenario list",
            "gcs scenario new mine.toml",
            "gcs scenario show mine.toml",
            "gcs scenario check mine.toml",
        ],
    ),
    ("score", &["gcs score runs/demo/crpl", "gcs score runs/demo/*/ --json"]),
    ("compare", &["gcs compare runs/demo/crpl runs/demo/rcc"]),
    ("merge", &["gcs merge runs/b/1-of-2 runs/b/2-of-2 --out runs/b/all"]),
    ("report", &["gcs report scenarios", "gcs report runs/bandwidth --out runs/report"]),
    (
        "bridge",
        &[
            "gcs bridge --connect udpin:0.0.0.0:14550 --forward udpin:127.0.0.1:14560",
            "gcs bridge --connect tcpout:uav:5760 --forward tcpin:127.0.0.1:5761 --watch",
            "gcs bridge --connect serial:/dev/ttyACM0:57600 --forward tcpin:0.0.0.0:5760",
        ],
    ),
    (
        "link",
        &[
            "gcs link --radio wifi --vehicle tcpout:uav:5760 --ground tcpin:127.0.0.1:5761",
            "gcs link --radio sik-57 --traffic flight.tlog --summary",
        ],
    ),
    ("encode", &["gcs encode --vehicle udpout:127.0.0.1:14550 --ground udpin:127.0.0.1:14560"]),
    (
        "param",
        &[
            "gcs param list",
            "gcs param set RADIO_TXP 4",
            "gcs param --connect udpin:0.0.0.0:14550 save mine.params",
        ],
    ),
    (
        "mission",
        &["gcs mission upload survey.plan", "gcs mission download now.plan", "gcs mission clear --all"],
    ),
    (
        "replay",
        &[
            "gcs replay runs/demo/crpl --watch",
            "gcs replay flight.tlog --forward udpout:127.0.0.1:14550 --speed 10",
            "gcs replay runs/recording --watch",
        ],
    ),
    ("export", &["gcs export runs/demo/crpl --to mcap", "gcs export flight.tlog --to gpx --out flight.gpx"]),
    (
        "tlog",
        &[
            "gcs tlog info flight.tlog",
            "gcs tlog cut flight.tlog --from 10 --to 60 --out part.tlog",
            "gcs tlog merge a.tlog b.tlog --out both.tlog",
        ],
    ),
    ("key", &["gcs key new key.toml", "gcs key show-fingerprint key.toml"]),
    ("sitl", &["gcs sitl --pace lockstep --ticks 100"]),
];
