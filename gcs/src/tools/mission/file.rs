//! Mission files: QGroundControl's `.plan` (JSON) and the older `QGC WPL 110` (text, one item a line).
//!
//! A plan keeps home apart, WPL has it as its first line, as ArduPilot has it as item 0; other autopilots have
//! no home among their items. Jumps name their item by its number in WPL, by its id in a plan; here by its
//! place among the items without home.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;
use serde_json::{Value, json};

use super::item::Item;

const WPL: &str = "QGC WPL 110";
/// The versions of the text that are read; all have the same columns.
const WPL_READ: [&str; 3] = ["QGC WPL 100", WPL, "QGC WPL 120"];
const NAV_WAYPOINT: u16 = 16;
const DO_JUMP: u16 = 177;
const FENCE_RETURN_POINT: u16 = 5000;
const FENCE_POLYGON: [u16; 2] = [5001, 5002];
const FENCE_CIRCLE: [u16; 2] = [5003, 5004];
const RALLY_POINT: u16 = 5100;
const FRAME_GLOBAL: u8 = 0;
const FRAME_RELATIVE: u8 = 3;

/// What a file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MissionPlan {
    /// Home, if the file keeps it apart.
    pub home: Option<Item>,
    /// The items. A DO_JUMP's param1 is the place of its item here; -1 is home.
    pub items: Vec<Item>,
    /// The geofence, as items of its own list.
    pub fence: Vec<Item>,
    /// Rally points, as items of their own list.
    pub rally: Vec<Item>,
}

/// An item at a place in the world that asks for nothing else.
fn at(command: u16, frame: u8, [x, y, z]: [f64; 3]) -> Item {
    let (current, autocontinue) = (false, true);
    Item { frame, command, current, autocontinue, params: [0.0; 4], x, y, z: z as f32 }
}

/// The same items with their jumps that many places further.
fn jumps_moved(items: &mut [Item], by: f32) {
    for item in items.iter_mut().filter(|item| item.command == DO_JUMP) {
        item.params[0] += by;
    }
}

impl MissionPlan {
    /// What a vehicle is given: home first for those that want it so, who get a place for it even where the file
    /// has none.
    ///
    /// # Errors
    /// A jump to an item that is not there.
    pub fn items_for(&self, home_first: bool) -> Result<Vec<Item>> {
        if self.items.is_empty() {
            return Ok(Vec::new());
        }
        let first = if home_first { -1.0 } else { 0.0 };
        for (k, item) in self.items.iter().enumerate().filter(|(_, item)| item.command == DO_JUMP) {
            let to = item.params[0];
            ensure!(
                (first..self.items.len() as f32).contains(&to),
                "item {k} jumps to an item that is not there"
            );
        }
        let mut items = Vec::new();
        if home_first {
            items.push(self.home_or_first());
        }
        items.extend_from_slice(&self.items);
        jumps_moved(&mut items, f32::from(u8::from(home_first)));
        let begins = usize::from(home_first);
        if !items.iter().skip(begins).any(|item| item.current)
            && !self.home.is_some_and(|home| home_first && home.current)
            && let Some(first) = items.first_mut()
        {
            first.current = true;
        }
        Ok(items)
    }

    /// What a vehicle has given.
    #[must_use]
    pub fn downloaded(mut items: Vec<Item>, home_first: bool) -> Self {
        let home = (home_first && !items.is_empty()).then(|| items.remove(0));
        jumps_moved(&mut items, -f32::from(u8::from(home.is_some())));
        Self { home, items, ..Self::default() }
    }

    /// Home, or the first place of the mission in its stead.
    fn home_or_first(&self) -> Item {
        let first = self.items.iter().find(|item| item.x != 0.0 && item.frame != 2);
        let place = first.map_or([0.0; 3], |item| [item.x, item.y, 0.0]);
        self.home.unwrap_or_else(|| Item { current: true, ..at(NAV_WAYPOINT, FRAME_GLOBAL, place) })
    }

    /// Writes the file: a plan if its name ends so, else WPL.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let is_plan = path.extension().is_some_and(|end| end == "plan");
        let text = if is_plan { self.to_plan() } else { self.to_wpl() };
        std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))
    }

    fn to_plan(&self) -> String {
        let home = self.home_or_first();
        let items: Vec<Value> = self.items.iter().enumerate().map(|(k, item)| simple_item(k, item)).collect();
        let rally: Vec<_> = self.rally.iter().map(|item| json!([item.x, item.y, item.z])).collect();
        let plan = json!({
            "fileType": "Plan",
            "version": 1,
            "groundStation": "gcs",
            "mission": {
                "version": 2,
                "firmwareType": 0,
                "vehicleType": 2,
                "cruiseSpeed": 15,
                "hoverSpeed": 5,
                "globalPlanAltitudeMode": 1,
                "plannedHomePosition": [home.x, home.y, f64::from(home.z)],
                "items": items,
            },
            "geoFence": fence_json(&self.fence),
            "rallyPoints": { "version": 2, "points": rally },
        });
        format!("{plan:#}\n")
    }

    fn to_wpl(&self) -> String {
        let mut text = format!("{WPL}\n");
        // Its readers take the first line for home, whatever it holds.
        let home = (!self.items.is_empty() || self.home.is_some()).then(|| self.home_or_first());
        let mut items: Vec<Item> = home.into_iter().chain(self.items.iter().copied()).collect();
        jumps_moved(&mut items, 1.0);
        for (k, item) in items.iter().enumerate() {
            let [p1, p2, p3, p4] = item.params;
            let Item { frame, command, x, y, z, .. } = item;
            let (current, auto) = (u8::from(item.current), u8::from(item.autocontinue));
            let _ = writeln!(
                text,
                "{k}\t{current}\t{frame}\t{command}\t{p1}\t{p2}\t{p3}\t{p4}\t{x:.8}\t{y:.8}\t{z}\t{auto}"
            );
        }
        text
    }
}

/// A fence's items as a plan has them. Corners of a polygon follow each other, each with their number.
fn fence_json(fence: &[Item]) -> Value {
    let (mut circles, mut polygons, mut back) = (Vec::new(), Vec::new(), None);
    let mut rest = fence;
    while let Some((item, others)) = rest.split_first() {
        rest = others;
        if item.command == FENCE_RETURN_POINT {
            back = Some(json!([item.x, item.y, item.z]));
        } else if let Some(kind) = FENCE_CIRCLE.iter().position(|command| *command == item.command) {
            let circle = json!({ "center": [item.x, item.y], "radius": item.params[0] });
            circles.push(json!({ "circle": circle, "inclusion": kind == 0, "version": 1 }));
        } else if let Some(kind) = FENCE_POLYGON.iter().position(|command| *command == item.command) {
            let count = (item.params[0].max(1.0) as usize - 1).min(others.len());
            let (corners, others) = others.split_at(count);
            rest = others;
            let corners: Vec<_> = std::iter::once(item).chain(corners).map(|i| json!([i.x, i.y])).collect();
            polygons.push(json!({ "polygon": corners, "inclusion": kind == 0, "version": 1 }));
        }
    }
    let mut fence = json!({ "version": 2, "circles": circles, "polygons": polygons });
    if let Some(back) = back {
        fence["breachReturn"] = back;
    }
    fence
}

fn simple_item(k: usize, item: &Item) -> Value {
    // JSON has no NaN: null leaves a param to the vehicle.
    let number = |v: f64| if v.is_finite() { json!(v) } else { Value::Null };
    let mut params = item.params;
    if item.command == DO_JUMP {
        params[0] += 1.0;
    }
    let params: Vec<Value> = params
        .iter()
        .map(|&p| number(f64::from(p)))
        .chain([number(item.x), number(item.y), number(f64::from(item.z))])
        .collect();
    json!({
        "type": "SimpleItem",
        "autoContinue": item.autocontinue,
        "command": item.command,
        "doJumpId": k + 1,
        "frame": item.frame,
        "params": params,
    })
}

/// Reads a file of either kind.
///
/// # Errors
/// The file cannot be read, or is no mission: the error names the line.
pub fn read(path: &Path) -> Result<MissionPlan> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    parse(&text).with_context(|| path.display().to_string())
}

/// Reads a text of either kind.
///
/// # Errors
/// It is no mission: the error names the line.
pub fn parse(text: &str) -> Result<MissionPlan> {
    let text = text.trim_start_matches('\u{feff}');
    if text.trim_start().starts_with('{') {
        return parse_plan(text);
    }
    let mut lines = text.lines().enumerate().map(|(k, line)| (k + 1, line.trim()));
    let mut lines = lines.by_ref().filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let (number, head) = lines.next().unwrap_or((1, ""));
    if !WPL_READ.contains(&head) {
        bail!("line {number}: neither a .plan nor `{WPL}`");
    }
    let mut items = Vec::new();
    for (number, line) in lines {
        items.push(wpl_item(line).with_context(|| format!("line {number}"))?);
    }
    let is_home = items
        .first()
        .is_some_and(|first: &Item| first.command == NAV_WAYPOINT && first.frame == FRAME_GLOBAL);
    Ok(MissionPlan::downloaded(items, is_home))
}

fn wpl_item(line: &str) -> Result<Item> {
    let line = line.split('#').next().unwrap_or_default();
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, current, frame, command, p1, p2, p3, p4, x, y, z, auto] = words[..] else {
        bail!("{} columns in place of 12", words.len());
    };
    let number = |text: &str| text.parse::<f64>().with_context(|| format!("`{text}` is no number"));
    // Some programs write all columns as they write places: 16.000000.
    let whole = |text: &str| -> Result<u16> {
        let value = number(text)?;
        let fits = value.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&value);
        if fits { Ok(value as u16) } else { bail!("`{text}` is no whole number") }
    };
    let item = Item {
        frame: u8::try_from(whole(frame)?).with_context(|| format!("frame {frame}"))?,
        command: whole(command)?,
        current: whole(current)? != 0,
        autocontinue: whole(auto)? != 0,
        params: [number(p1)? as f32, number(p2)? as f32, number(p3)? as f32, number(p4)? as f32],
        x: number(x)?,
        y: number(y)?,
        z: number(z)? as f32,
    };
    checked(item)
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct PlanFile {
    file_type: String,
    mission: PlanMission,
    #[serde(default)]
    geo_fence: PlanFence,
    #[serde(default)]
    rally_points: PlanRally,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct PlanMission {
    planned_home_position: Option<Vec<Option<f64>>>,
    items: Vec<PlanItem>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct PlanFence {
    circles: Vec<PlanCircle>,
    polygons: Vec<PlanPolygon>,
    breach_return: Option<Vec<Option<f64>>>,
}

#[derive(Debug, Deserialize)]
struct PlanCircle {
    circle: PlanDisc,
    inclusion: bool,
}

#[derive(Debug, Deserialize)]
struct PlanDisc {
    center: Vec<Option<f64>>,
    radius: f64,
}

#[derive(Debug, Deserialize)]
struct PlanPolygon {
    polygon: Vec<Vec<Option<f64>>>,
    inclusion: bool,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct PlanRally {
    points: Vec<Vec<Option<f64>>>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct PlanItem {
    r#type: String,
    complex_item_type: Option<String>,
    command: Option<u16>,
    frame: Option<u8>,
    auto_continue: Option<bool>,
    do_jump_id: Option<f64>,
    params: Option<Vec<Option<f64>>>,
    /// Of a pattern: the waypoints that it stands for.
    #[serde(rename = "TransectStyleComplexItem")]
    transect: Option<PlanTransect>,
}

#[derive(Debug, Deserialize)]
struct PlanTransect {
    #[serde(rename = "Items", default)]
    items: Vec<PlanItem>,
}

fn parse_plan(text: &str) -> Result<MissionPlan> {
    let file: PlanFile = serde_json::from_str(text)?;
    if file.file_type != "Plan" {
        bail!("its fileType is `{}`, not Plan", file.file_type);
    }
    let home = file.mission.planned_home_position.as_deref().map(place);
    let home = home.transpose().context("plannedHomePosition")?;
    let home = home.map(|place| checked(Item { current: true, ..at(NAV_WAYPOINT, FRAME_GLOBAL, place) }));
    let (mut items, mut ids) = (Vec::new(), Vec::new());
    for (k, item) in file.mission.items.iter().enumerate() {
        plan_items(item, &mut items, &mut ids).with_context(|| format!("item {k}"))?;
    }
    for (k, item) in items.iter_mut().enumerate().filter(|(_, item)| item.command == DO_JUMP) {
        let to = ids.iter().position(|id| *id == Some(f64::from(item.params[0])));
        let to = to.with_context(|| format!("item {k} jumps to {}, which no item is", item.params[0]))?;
        item.params[0] = to as f32;
    }
    Ok(MissionPlan {
        home: home.transpose().context("plannedHomePosition")?,
        items,
        fence: fence_items(&file.geo_fence).context("geoFence")?,
        rally: file
            .rally_points
            .points
            .iter()
            .map(|point| checked(at(RALLY_POINT, FRAME_RELATIVE, place(point)?)))
            .collect::<Result<_>>()
            .context("rallyPoints")?,
    })
}

/// Latitude, longitude and height; without a height, as QGroundControl writes it where none is known, 0.
fn place(numbers: &[Option<f64>]) -> Result<[f64; 3]> {
    match *numbers {
        [Some(x), Some(y), ref z @ ..] => Ok([x, y, z.first().copied().flatten().unwrap_or(0.0)]),
        _ => bail!("fewer than 2 numbers"),
    }
}

fn fence_items(fence: &PlanFence) -> Result<Vec<Item>> {
    let mut items = Vec::new();
    for PlanPolygon { polygon, inclusion } in &fence.polygons {
        let command = FENCE_POLYGON[usize::from(!inclusion)];
        for corner in polygon {
            let count = polygon.len() as f32;
            items.push(Item { params: [count, 0.0, 0.0, 0.0], ..at(command, FRAME_GLOBAL, place(corner)?) });
        }
    }
    for PlanCircle { circle: PlanDisc { center, radius }, inclusion } in &fence.circles {
        ensure!(radius.is_finite() && *radius > 0.0, "a circle's radius is {radius}");
        let command = FENCE_CIRCLE[usize::from(!inclusion)];
        let params = [*radius as f32, 0.0, 0.0, 0.0];
        items.push(Item { params, ..at(command, FRAME_GLOBAL, place(center)?) });
    }
    if let Some(back) = &fence.breach_return {
        items.push(at(FENCE_RETURN_POINT, FRAME_RELATIVE, place(back)?));
    }
    items.into_iter().map(checked).collect()
}

/// The items that one of a plan stands for, and the ids by which jumps name them.
fn plan_items(item: &PlanItem, items: &mut Vec<Item>, ids: &mut Vec<Option<f64>>) -> Result<()> {
    if item.r#type == "SimpleItem" {
        items.push(plan_item(item)?);
        ids.push(item.do_jump_id);
        return Ok(());
    }
    let kind = item.complex_item_type.as_deref().unwrap_or(&item.r#type);
    let transect = item.transect.as_ref().filter(|transect| !transect.items.is_empty());
    let Some(transect) = transect else {
        bail!("`{kind}` is a pattern without waypoints: save the mission from QGroundControl as waypoints");
    };
    transect.items.iter().try_for_each(|part| plan_items(part, items, ids)).with_context(|| kind.to_owned())
}

fn plan_item(item: &PlanItem) -> Result<Item> {
    let (Some(command), Some(frame), Some(params)) = (item.command, item.frame, &item.params) else {
        bail!("command, frame or params is missing");
    };
    let [p1, p2, p3, p4, x, y, z] = params[..] else {
        bail!("{} params in place of 7", params.len());
    };
    let param = |value: Option<f64>| value.map_or(f32::NAN, |v| v as f32);
    checked(Item {
        frame,
        command,
        current: false,
        autocontinue: item.auto_continue.unwrap_or(true),
        params: [p1, p2, p3, p4].map(param),
        x: x.unwrap_or(0.0),
        y: y.unwrap_or(0.0),
        z: z.unwrap_or(0.0) as f32,
    })
}

/// Refuses what no vehicle could fly to.
fn checked(item: Item) -> Result<Item> {
    if !(item.x.is_finite() && item.y.is_finite() && item.z.is_finite()) {
        bail!("its place is not finite");
    }
    let global = matches!(item.frame, 0 | 3 | 10);
    if global && (item.x.abs() > 90.0 || item.y.abs() > 180.0) {
        bail!("latitude {} and longitude {} are on no globe", item.x, item.y);
    }
    Ok(item)
}

#[cfg(test)]
mod tests {
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
}
