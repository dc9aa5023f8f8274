//! The page's server beside real flights: who may ask it, what it gives, and that no flight changes by it.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;

use serde_json::{Value, json};
use tests::program::{self, PATIENCE, Program};

/// A program with a page: its address, and the token in it.
fn page(program: &Program) -> (String, Option<String>) {
    program.logs("watch: http://").unwrap();
    let so_far = program.so_far();
    let address = so_far.lines().find_map(|line| line.strip_prefix("watch: http://")).unwrap();
    let (host, token) = address.split_once("/#token=").map_or((address, None), |(h, t)| (h, Some(t)));
    (host.trim().to_owned(), token.map(|token| token.trim().to_owned()))
}

/// A connection on which a request was made.
fn asked(host: &str, request: &str, headers: &[(&str, &str)], body: &str) -> TcpStream {
    let mut stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut text = format!("{request} HTTP/1.1\r\nConnection: close\r\nContent-Length: {}\r\n", body.len());
    let named = headers.iter().any(|(name, _)| *name == "Host");
    let host = if named { String::new() } else { format!("Host: {host}\r\n") };
    let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    text += &format!("{host}{headers}\r\n{body}");
    stream.write_all(text.as_bytes()).unwrap();
    stream
}

/// The status and the body of an answer.
fn answer(host: &str, request: &str, headers: &[(&str, &str)], body: &str) -> (u16, String) {
    let (mut stream, mut text) = (asked(host, request, headers, body), String::new());
    stream.read_to_string(&mut text).unwrap();
    let status = text.split(' ').nth(1).unwrap().parse().unwrap();
    (status, text.split_once("\r\n\r\n").unwrap().1.to_owned())
}

/// Reads the events of a stream up to one that `wanted` likes.
fn events(stream: &mut TcpStream, wanted: impl Fn(&Value) -> bool) -> Vec<Value> {
    let (mut bytes, mut buffer, mut seen, mut events) = (Vec::new(), [0; 65_536], 0, Vec::new());
    loop {
        let n = stream.read(&mut buffer).unwrap();
        assert!(n > 0, "the stream ended after {events:?}");
        bytes.extend(&buffer[..n]);
        while let Some(end) = bytes[seen..].iter().position(|b| *b == b'\n') {
            let line = String::from_utf8_lossy(&bytes[seen..seen + end]).into_owned();
            seen += end + 1;
            if let Some(data) = line.strip_prefix("data: ")
                && let Ok(event) = serde_json::from_str::<Value>(data)
            {
                let found = wanted(&event);
                events.push(event);
                if found {
                    return events;
                }
            }
        }
    }
}

fn is_end(event: &Value) -> bool {
    event["kind"] == "end"
}

/// How many events of each kind.
fn kinds(events: &[Value]) -> BTreeMap<&str, usize> {
    let mut kinds = BTreeMap::new();
    for event in events {
        *kinds.entry(event["kind"].as_str().unwrap()).or_default() += 1;
    }
    kinds
}

/// The lines inside a `flight.html`.
fn lines_in(path: &Path) -> Vec<Value> {
    let html = fs::read_to_string(path).unwrap();
    let lines = crpl_gcs::watch::document::lines_of(&html).unwrap();
    lines.iter().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn demo(out: &Path, more: &[&str]) -> Program {
    let args = [&["demo", "--controller", "crpl,rcc", "--out", out.to_str().unwrap()], more].concat();
    Program::start("gcs", &args, None).unwrap()
}

#[test]
fn a_watched_flight_keeps_its_bytes_and_leaves_a_page_that_holds_it() {
    let dir = tempfile::tempdir().unwrap();
    let (alone, watched) = (dir.path().join("alone"), dir.path().join("watched"));
    demo(&alone, &[]).wait().unwrap().good().unwrap();
    let program = demo(&watched, &["--watch"]);
    program.wait().unwrap().good().unwrap();
    for name in ["crpl", "rcc"] {
        let record = |dir: &Path| fs::read(dir.join(name).join("record.jsonl")).unwrap();
        assert!(record(&alone) == record(&watched), "{name}: other bytes");
        for dir in [&alone, &watched] {
            let page = dir.join(name).join("flight.html");
            assert!(fs::metadata(&page).unwrap().len() < 2_000_000, "{}", page.display());
            let lines = lines_in(&page);
            let count = kinds(&lines);
            assert_eq!((count["hello"], count["tick"], count["end"]), (1, 100, 1), "{count:?}");
            assert_eq!(count["command"], 100, "every command has a fate");
            assert!(count["picture"] > 20 && count["belief"] > 20 && count["field"] > 0, "{count:?}");
            let beliefs: Vec<_> = lines.iter().filter(|line| line["kind"] == "belief").collect();
            let foresees =
                beliefs.iter().all(|belief| belief["fan"][0].as_array().is_some_and(|f| f.len() == 100));
            assert_eq!(foresees, name == "crpl", "{name} has a policy to look ahead with, or not");
        }
    }
}

#[test]
fn what_the_model_believes_is_near_what_was_flown() {
    let dir = tempfile::tempdir().unwrap();
    // Without gusts, which nobody can foresee.
    demo(dir.path(), &["--scenario", "2"]).wait().unwrap().good().unwrap();
    let lines = lines_in(&dir.path().join("crpl/flight.html"));
    let of = |kind: &str| lines.iter().filter(|line| line["kind"] == kind).collect::<Vec<_>>();
    let flown: BTreeMap<u64, &Value> = of("tick").iter().map(|t| (t["tick"].as_u64().unwrap(), *t)).collect();
    let place = |value: &Value| [0, 1].map(|i| value[i].as_f64().unwrap());
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    for belief in of("belief") {
        let tick = belief["tick"].as_u64().unwrap();
        let off = apart(place(&belief["position"]), place(&flown[&tick]["r"]));
        assert!(off < 0.003, "tick {tick}: {off} from where it was");
        for ahead in [1, 10, 30] {
            let Some(then) = flown.get(&(tick + ahead as u64 - 1)) else { continue };
            let off = apart(place(&belief["fan"][0][ahead - 1]), place(&then["r_next"]));
            assert!(off < 0.02, "tick {tick}: after {ahead} intervals {off} from where it went");
        }
    }
    let field = of("field")[0];
    assert_eq!(field["snr_db"].as_array().unwrap().len(), 48 * 48);
}

#[test]
fn other_hosts_and_other_origins_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let program = demo(dir.path(), &["--watch", "--watch-stay"]);
    let (host, token) = page(&program);
    assert_eq!(token, None, "a page that only watches has no token");
    let port = host.rsplit(':').next().unwrap();
    let (status, html) = answer(&host, "GET /", &[], "");
    assert_eq!(status, 200);
    assert!(html.contains("<html"), "{html}");
    let named = [format!("evil.example:{port}"), "127.0.0.1:1".into(), "evil.example".into(), String::new()];
    for path in ["/", "/events", "/flight.json"] {
        for name in &named {
            assert_eq!(
                answer(&host, &format!("GET {path}"), &[("Host", name)], "").0,
                403,
                "{path} as {name:?}"
            );
        }
        let origin = [("Origin", "http://evil.example")];
        assert_eq!(answer(&host, &format!("GET {path}"), &origin, "").0, 403, "{path} from another origin");
    }
    let same = format!("http://localhost:{port}");
    let local = format!("localhost:{port}");
    assert_eq!(answer(&host, "GET /flight.json", &[("Host", &local), ("Origin", &same)], "").0, 200);
    let (status, text) = answer(&host, "POST /control", &[], r#"{"token":"","vehicle":1,"action":"land"}"#);
    assert_eq!(status, 403, "{text}");
    program.interrupt().unwrap();
}

#[test]
fn two_readers_get_all_of_a_flight_while_a_third_reads_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let program = demo(dir.path(), &["--pace", "realtime", "--speed", "20", "--watch", "--watch-stay"]);
    let (host, _) = page(&program);
    let _deaf = asked(&host, "GET /events", &[], "");
    let [mut one, mut two] = [(); 2].map(|()| asked(&host, "GET /events", &[], ""));
    let (first, second) = (events(&mut one, is_end), events(&mut two, is_end));
    assert_eq!(first, second);
    let ticks = |id: u64| first.iter().filter(|e| e["kind"] == "tick" && e["vehicle"] == id).count();
    assert!(ticks(1) > 0 && ticks(2) > 0, "{:?}", kinds(&first));
    let flown: Vec<Value> = serde_json::from_str(&answer(&host, "GET /flight.json", &[], "").1).unwrap();
    assert_eq!(flown, first);
    program.interrupt().unwrap();
    assert!(program.wait().unwrap().good().is_ok(), "the third one holds up the end");
}

#[test]
fn a_reader_that_comes_back_goes_on_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let program = demo(dir.path(), &["--watch", "--watch-stay"]);
    let (host, _) = page(&program);
    let all = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    let rest = events(&mut asked(&host, "GET /events", &[("Last-Event-ID", "10")], ""), is_end);
    assert_eq!(rest, all[11..]);
    program.interrupt().unwrap();
}

#[test]
fn a_page_that_may_steer_holds_the_vehicle_and_gives_it_back() {
    let dir = tempfile::tempdir().unwrap();
    let (_vehicle, address) = program::sitl(&["--pace", "realtime", "--speed", "4"]).unwrap();
    let args =
        ["fly", "--connect", &format!("udpout:{address}"), "--controller", "rcc", "--watch", "--control"];
    let args = [&args[..], &["--watch-stay", "--out", dir.path().to_str().unwrap()]].concat();
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, token) = page(&program);
    let mut stream = asked(&host, "GET /events", &[], "");
    events(&mut stream, |event| event["kind"] == "tick");
    let ask = |token: &str, action: &str| {
        let body = json!({ "token": token, "vehicle": 1, "action": action }).to_string();
        let (status, text) = answer(&host, "POST /control", &[], &body);
        (status, serde_json::from_str::<Value>(&text).unwrap())
    };
    assert_eq!(ask("", "hold").0, 403, "no token");
    assert_eq!(ask(&"0".repeat(32), "hold").0, 403, "another token");
    let token = token.unwrap();
    let held = ask(&token, "hold");
    assert_eq!((held.0, &held.1["ok"]), (200, &json!(true)), "{held:?}");
    program.logs("no more setpoints from here").unwrap();
    let back = ask(&token, "give_back");
    assert_eq!(back.1["ok"], true, "{back:?}");
    program.logs("given back").unwrap();
    events(&mut stream, |event| event["kind"] == "tick" && event["tick"].as_u64() > Some(40));
    let landed = ask(&token, "land");
    assert_eq!(landed.1["ok"], true, "{landed:?}");
    program.logs("the operator has taken over (vehicle is in LAND)").unwrap();
    // The first ends the wait for the vehicle, the second the page.
    program.interrupt().unwrap();
    program.logs("the page stays").unwrap();
    program.interrupt().unwrap();
    let ended = program.wait().unwrap();
    assert_eq!(ended.status.code(), Some(4), "taken over: {}", ended.stderr);
}

#[test]
fn a_replay_shows_the_flight_that_was_recorded() {
    let dir = tempfile::tempdir().unwrap();
    demo(dir.path(), &[]).wait().unwrap().good().unwrap();
    let folder = dir.path().join("crpl");
    let args = ["replay", folder.to_str().unwrap(), "--speed", "1000", "--watch", "--watch-stay"];
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    assert_eq!(told, lines_in(&folder.join("flight.html")));
    program.interrupt().unwrap();
}

#[test]
fn a_bridge_shows_the_vehicles_that_it_hears() {
    let (_vehicle, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let vehicle = format!("udpout:{address}");
    let args = ["bridge", "--connect", &vehicle, "--forward", "udpin:127.0.0.1:0", "--watch", "--control"];
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, token) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), |event| event["kind"] == "tick");
    assert!(told.iter().any(|event| event["kind"] == "hello" && event["vehicles"][0]["id"] == 1), "{told:?}");
    let body = json!({ "token": token, "vehicle": 1, "action": "hold" }).to_string();
    let (_, text) = answer(&host, "POST /control", &[], &body);
    assert!(text.contains("\"ok\":true"), "{text}");
    program.interrupt().unwrap();
}

#[test]
fn a_bridge_shows_buildings_on_its_map() {
    let dir = tempfile::tempdir().unwrap();
    let town = dir.path().join("town.geojson");
    let ring = "[[8.5456,47.3977],[8.5457,47.3977],[8.5457,47.3978],[8.5456,47.3977]]";
    fs::write(&town, format!(r#"{{"type":"Polygon","coordinates":[{ring}]}}"#)).unwrap();
    let (_vehicle, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let vehicle = format!("udpout:{address}");
    let town = town.to_str().unwrap();
    let ends = ["bridge", "--connect", &vehicle, "--forward", "udpin:127.0.0.1:0"];
    let args = [&ends[..], &["--watch", "--buildings", town]].concat();
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), |event| event["kind"] == "geo");
    let geo = told.last().unwrap();
    assert_eq!(geo["buildings"]["coordinates"][0][0][2], json!([8.5457, 47.3978]), "{geo}");
    program.interrupt().unwrap();
    let refused = Program::start("gcs", &[&ends[..], &["--buildings", town]].concat(), None).unwrap();
    assert_eq!(refused.wait().unwrap().status.code(), Some(2), "a map needs a page");
}

#[test]
fn a_link_shows_the_vehicle_that_comes_through_and_its_station() {
    let (_vehicle, address) = program::sitl(&["--pace", "realtime"]).unwrap();
    let vehicle = format!("udpout:{address}");
    let args = ["link", "--radio", "wifi", "--vehicle", &vehicle, "--ground", "udpin:127.0.0.1:0", "--watch"];
    let link = Program::start("gcs", &args, None).unwrap();
    let ground = link.line("ground: listening on udpin:").unwrap();
    let (host, _) = page(&link);
    // A tool that says hello.
    let tool = ["bridge", "--connect", &format!("udpout:{ground}"), "--forward", "udpin:127.0.0.1:0"];
    let tool = Program::start("gcs", &tool, None).unwrap();
    let stands =
        |event: &Value| event["kind"] == "hello" && event["scenario"]["channel"]["base_station"].is_array();
    let mut stream = asked(&host, "GET /events", &[], "");
    let told = events(&mut stream, stands);
    let count = kinds(&told);
    assert!(count["geo"] == 1 && count["tick"] > 0 && count["link"] > 0, "{count:?}");
    let has_snr = |event: &Value| event["kind"] == "tick" && event["snr_db"].is_f64();
    events(&mut stream, has_snr);
    tool.interrupt().unwrap();
    link.interrupt().unwrap();
    link.wait().unwrap().good().unwrap();
}

#[test]
fn a_recording_is_watched_and_replayed() {
    let dir = tempfile::tempdir().unwrap();
    let (_vehicle, address) = program::sitl(&["--pace", "lockstep"]).unwrap();
    let (vehicle, out) = (format!("udpout:{address}"), dir.path().join("recording"));
    let flags = ["--episodes", "2", "--pictures", "30", "--out", out.to_str().unwrap()];
    let args = [&["record", "--connect", &vehicle, "--watch", "--watch-stay"][..], &flags].concat();
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, _) = page(&program);
    let flown = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    program.interrupt().unwrap();
    program.wait().unwrap().good().unwrap();
    let count = kinds(&flown);
    assert_eq!((count["hello"], count["picture"], count["tick"]), (1, 60, 59), "{count:?}");
    let progress = flown.iter().rfind(|event| event["kind"] == "progress").unwrap();
    assert_eq!((&progress["done"], &progress["total"]), (&json!(2), &json!(2)));

    let args = ["replay", out.to_str().unwrap(), "--speed", "1000", "--watch", "--watch-stay"];
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    program.interrupt().unwrap();
    let count = kinds(&told);
    // Two episodes of 29 intervals; the last picture of each begins none.
    assert_eq!((count["tick"], count["picture"]), (58, 58), "{count:?}");
    let of = |events: &[Value], kind: &str| -> Vec<Value> {
        events.iter().filter(|event| event["kind"] == kind).cloned().collect()
    };
    let (flown, told) = (of(&flown, "tick"), of(&told, "tick"));
    for (flown, told) in flown[..29].iter().zip(&told) {
        for key in ["tick", "snr_db", "power", "outage"] {
            assert_eq!(flown[key], told[key], "{key} of {flown}");
        }
        for k in 0..2 {
            let apart = flown["r_next"][k].as_f64().unwrap() - told["r_next"][k].as_f64().unwrap();
            assert!(apart.abs() < 1e-6, "{flown}, {told}");
        }
    }
}

#[test]
fn a_record_alone_is_replayed_as_it_was_flown() {
    let dir = tempfile::tempdir().unwrap();
    demo(dir.path(), &["--scenario", "2"]).wait().unwrap().good().unwrap();
    let (run, alone) = (dir.path().join("crpl"), dir.path().join("alone.jsonl"));
    fs::copy(run.join("record.jsonl"), &alone).unwrap();
    let args = ["replay", alone.to_str().unwrap(), "--speed", "1000", "--watch", "--watch-stay"];
    let program = Program::start("gcs", &args, None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    program.interrupt().unwrap();
    let of = |events: &[Value], kind: &str| -> Vec<Value> {
        events.iter().filter(|event| event["kind"] == kind).cloned().collect()
    };
    let before = lines_in(&run.join("flight.html"));
    for kind in ["tick", "command"] {
        assert_eq!(of(&told, kind), of(&before, kind), "{kind}");
    }
    assert!(kinds(&told)["field"] > 0);
}

#[test]
fn a_training_shows_its_curves() {
    let dir = tempfile::tempdir().unwrap();
    let config = dir.path().join("small.toml");
    let recording = "[learned.recording]\nepisodes = 6\npictures = 24\n";
    let encoder = "[learned.encoder]\nsteps = 100\ntriples = 2\nheld_out = 1\n";
    fs::write(&config, format!("{recording}{encoder}")).unwrap();
    let out = dir.path().join("model");
    let args = ["train", "--config", config.to_str().unwrap(), "--out", out.to_str().unwrap()];
    let program = Program::start("model", &[&args[..], &["--watch"]].concat(), None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), |event| {
        event["kind"] == "curve" && event["x"] == 100.0 && event["name"] == "encoder: error of the gain, dB"
    });
    let curves: std::collections::BTreeSet<&str> = told
        .iter()
        .filter(|event| event["kind"] == "curve")
        .filter_map(|event| event["name"].as_str())
        .collect();
    for name in ["encoder: loss", "encoder: correlation of z_c with the actions", "encoder: error of z_u, px"]
    {
        assert!(curves.contains(name), "{curves:?}");
    }
    assert!(told.iter().any(|event| event["kind"] == "progress" && event["text"] == "recording"));
    assert_eq!(told[0]["program"], "model train");
    program.interrupt().unwrap();
}

#[test]
fn a_sweep_shows_how_far_it_is_before_its_first_flight_and_its_points_at_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("sweep");
    let sweep = ["sweep", "--config", "configs/sweep_bandwidth.toml", "--points", "2.5,4", "--episodes", "2"];
    let more = ["--controller", "crpl,rcc", "--out", out.to_str().unwrap(), "--watch"];
    let program = Program::start("gcs", &[&sweep[..], &more].concat(), None).unwrap();
    let (host, _) = page(&program);
    let told = events(&mut asked(&host, "GET /events", &[], ""), is_end);
    let progress: Vec<[u64; 2]> = told
        .iter()
        .filter(|event| event["kind"] == "progress")
        .map(|event| ["done", "total"].map(|key| event[key].as_u64().unwrap()))
        .collect();
    assert_eq!((progress[0], progress.len(), kinds(&told)["point"] > 0), ([0, 8], 9, true));
    program.wait().unwrap().good().unwrap();
}
