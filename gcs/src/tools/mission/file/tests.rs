//! The files that people have, and what is wrong with others.

use super::*;

const SAMPLE: &str = "QGC WPL 110\r
0\t1\t0\t16\t0\t0\t0\t0\t47.39774200\t8.54559400\t488\t1\r
1\t0\t3\t22\t15\t0\t0\t0\t0\t0\t30\t1\r
2\t0\t3\t16\t0\t2.5\t0\t0\t47.39880000\t8.54660000\t30\t1\r
";

#[test]
fn wpl_text_is_read_and_written_again() {
    let plan = parse(SAMPLE).unwrap();
    assert_eq!((plan.home.unwrap().z, plan.items.len()), (488.0, 2));
    assert_eq!((plan.items[1].x, plan.items[1].params[1]), (47.3988, 2.5));
    assert_eq!(parse(&plan.to_wpl()).unwrap(), plan);
}

#[test]
fn a_plan_keeps_home_apart_and_comes_back() {
    let plan = parse(SAMPLE).unwrap();
    let flown = plan.items_for(true).unwrap();
    assert_eq!((plan.home, flown.len()), (Some(flown[0]), 3));
    let back = parse(&plan.to_plan()).unwrap();
    assert_eq!(back.items_for(true).unwrap(), flown);
    assert_eq!(back.items_for(false).unwrap().len(), 2);
    assert!(back.items_for(false).unwrap()[0].current, "somewhere it begins");
}

/// Report A4: the home line of a WPL file became PX4's waypoint 0, 488 m high.
#[test]
fn a_home_line_is_no_waypoint_of_px4() {
    let items = parse(SAMPLE).unwrap().items_for(false).unwrap();
    assert_eq!(items.iter().map(|item| item.command).collect::<Vec<_>>(), [22, 16]);
    // And PX4's mission gets a home line, which readers of the text swallow.
    let text = MissionPlan::downloaded(items.clone(), false).to_wpl();
    assert_eq!(parse(&text).unwrap().items, items);
    assert_eq!(text.lines().count(), 4);
}

/// Report A4: jumps were off by one on PX4.
#[test]
fn a_jump_leads_to_the_same_item_whatever_the_file_and_the_vehicle() {
    let jump = "3\t0\t3\t177\t2\t5\t0\t0\t0\t0\t0\t1\r\n";
    let plan = parse(&format!("{SAMPLE}{jump}")).unwrap();
    let to = |items: Vec<Item>| items[items.last().unwrap().params[0] as usize].command;
    for plan in [&plan, &parse(&plan.to_plan()).unwrap(), &parse(&plan.to_wpl()).unwrap()] {
        for home_first in [true, false] {
            assert_eq!(to(plan.items_for(home_first).unwrap()), 16);
            let items = plan.items_for(home_first).unwrap();
            assert_eq!(MissionPlan::downloaded(items, home_first).items[2].params[0], 1.0);
        }
    }
    let lost = parse(&format!("{SAMPLE}{}", jump.replace("177\t2", "177\t9"))).unwrap();
    assert!(lost.items_for(true).is_err());
}

/// Report G6: comments, a blank first line, other versions, floats in every column.
#[test]
fn the_wpl_files_that_people_have_are_read() {
    let plan = parse(SAMPLE).unwrap();
    for text in [
        SAMPLE.replace("\r\n1\t", "\r\n# a comment\r\n1\t"),
        format!("\n\n{SAMPLE}"),
        SAMPLE.replace("110", "120"),
        SAMPLE.replace("\t16\t", "\t16.000000\t").replace("\t22\t", "\t22.0\t"),
    ] {
        assert_eq!(parse(&text).unwrap(), plan, "{text}");
    }
}

/// Report G6: patterns hold ready waypoints, and a home may have no height.
#[test]
fn a_survey_s_waypoints_and_a_home_without_height_are_read() {
    let item = |id: u32| {
        format!(
            r#"{{"type":"SimpleItem","command":16,"frame":3,"doJumpId":{id},"autoContinue":true,
            "params":[0,0,0,null,47.{id},8.5,30]}}"#
        )
    };
    let (one, two, three) = (item(1), item(2), item(3));
    let text = format!(
        r#"{{"fileType":"Plan","mission":{{"plannedHomePosition":[47.3,8.5,null],"items":[{one},
        {{"type":"ComplexItem","complexItemType":"survey","polygon":[],
        "TransectStyleComplexItem":{{"Items":[{two},{three}],"Refly90Degrees":false}}}}]}}}}"#
    );
    let plan = parse(&text).unwrap();
    assert_eq!(plan.items.iter().map(|item| item.x).collect::<Vec<_>>(), [47.1, 47.2, 47.3]);
    assert_eq!(plan.home.unwrap().z, 0.0);
}

/// Report G5: fences and rally points were dropped without a word.
#[test]
fn fences_and_rally_points_of_a_plan_become_their_own_lists() {
    let text = r#"{"fileType":"Plan","mission":{"items":[]},
        "geoFence":{"version":2,"breachReturn":[47.2,8.2,30],
            "circles":[{"circle":{"center":[47.3977,8.5456],"radius":100},"inclusion":true}],
            "polygons":[{"polygon":[[47,8],[47.1,8],[47.1,8.1]],"inclusion":false}]},
        "rallyPoints":{"version":2,"points":[[47.3977,8.5456,50]]}}"#;
    let plan = parse(text).unwrap();
    let commands: Vec<_> = plan.fence.iter().map(|item| (item.command, item.params[0])).collect();
    assert_eq!(commands, [(5002, 3.0), (5002, 3.0), (5002, 3.0), (5003, 100.0), (5000, 0.0)]);
    assert_eq!((plan.rally.len(), plan.rally[0].command, plan.rally[0].z), (1, 5100, 50.0));
    assert!(plan.items_for(true).unwrap().is_empty(), "a fence alone is no mission");
    let again = parse(&plan.to_plan()).unwrap();
    assert_eq!((&again.fence, &again.rally), (&plan.fence, &plan.rally));
}

#[test]
fn null_leaves_a_param_to_the_vehicle() {
    let text = r#"{"fileType":"Plan","mission":{"items":[{"type":"SimpleItem","command":16,
        "frame":3,"params":[0,0,0,null,47.1,8.2,30]}]}}"#;
    let plan = parse(text).unwrap();
    assert!(plan.items[0].params[3].is_nan() && plan.home.is_none());
    assert!(plan.to_plan().contains("null"));
}

#[test]
fn what_is_wrong_is_said_with_its_place() {
    for (text, why) in [
        ("waypoints", "line 1: neither a .plan nor `QGC WPL 110`"),
        ("QGC WPL 110\n0 1 0\n", "line 2: 3 columns in place of 12"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 north 8 30 1\n", "line 2: `north` is no number"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 97 8 30 1\n", "line 2: latitude 97 and longitude 8"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 nan 8 30 1\n", "line 2: its place is not finite"),
        (r#"{"fileType":"Parameters","mission":{"items":[]}}"#, "its fileType is `Parameters`"),
        (
            r#"{"fileType":"Plan","mission":{"items":[{"type":"ComplexItem","complexItemType":"survey"}]}}"#,
            "item 0: `survey` is a pattern without waypoints",
        ),
        (
            r#"{"fileType":"Plan","mission":{"items":[{"type":"SimpleItem","command":16,"frame":3,"params":[1]}]}}"#,
            "item 0: 1 params in place of 7",
        ),
    ] {
        let error = crpl_sitl::program::terminal::one_line(&parse(text).unwrap_err());
        assert!(error.starts_with(why), "{error}");
    }
}

/// A fence without an area went up to the vehicle, which refused it behind a mission that was uploaded already.
#[test]
fn a_polygon_without_an_area_is_refused_before_anything_is_uploaded() {
    let plan = r#"{"fileType":"Plan","mission":{"items":[]},"geoFence":{"circles":[],"polygons":
        [{"polygon":[[47,8],[47,9]],"inclusion":true}]}}"#;
    let error = format!("{:#}", parse(plan).unwrap_err());
    assert!(error.contains("a polygon has 2 corners"), "{error}");
}

/// Mission Planner on Windows writes comments in its own code page.
#[test]
fn a_file_of_a_windows_editor_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.waypoints");
    let text = format!("{}# 45° caf\u{e9}\r\n", SAMPLE);
    let utf16: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
    for bytes in [[b"\xff\xfe", &utf16[..]].concat(), latin, [SAMPLE.as_bytes(), b"\x1a"].concat()] {
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read(&path).unwrap(), parse(SAMPLE).unwrap());
    }
}
