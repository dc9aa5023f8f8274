//! Mission files: QGroundControl's `.plan` (JSON) and the older `QGC WPL 110` (text, one item a line).
//!
//! A plan keeps home apart, WPL has it as its first line, as ArduPilot has it as item 0.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::item::Item;

const WPL: &str = "QGC WPL 110";
const NAV_WAYPOINT: u16 = 16;
const FRAME_GLOBAL: u8 = 0;

/// What a file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MissionPlan {
    /// Home, if the file keeps it apart.
    pub home: Option<Item>,
    /// The items.
    pub items: Vec<Item>,
}

impl MissionPlan {
    /// What a vehicle is given: home first for those that want it so.
    #[must_use]
    pub fn items_for(&self, home_first: bool) -> Vec<Item> {
        let home = self.home.filter(|_| home_first);
        let mut items: Vec<_> = home.into_iter().chain(self.items.iter().copied()).collect();
        if !items.iter().any(|item| item.current)
            && let Some(first) = items.first_mut()
        {
            first.current = true;
        }
        items
    }

    /// What a vehicle has given.
    #[must_use]
    pub fn downloaded(mut items: Vec<Item>, home_first: bool) -> Self {
        let home = (home_first && !items.is_empty()).then(|| items.remove(0));
        Self { home, items }
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
        let place = |home: Item| [home.x, home.y, f64::from(home.z)];
        let first = self.items.iter().find(|item| item.x != 0.0 && item.frame != 2);
        let home = self.home.or(first.copied()).map_or([0.0; 3], place);
        let items: Vec<Value> = self.items.iter().enumerate().map(|(k, item)| simple_item(k, item)).collect();
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
                "plannedHomePosition": home,
                "items": items,
            },
            "geoFence": { "version": 2, "circles": [], "polygons": [] },
            "rallyPoints": { "version": 2, "points": [] },
        });
        format!("{plan:#}\n")
    }

    fn to_wpl(&self) -> String {
        let mut text = format!("{WPL}\n");
        for (k, item) in self.home.iter().chain(&self.items).enumerate() {
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

fn simple_item(k: usize, item: &Item) -> Value {
    // JSON has no NaN: null leaves a param to the vehicle.
    let number = |v: f64| if v.is_finite() { json!(v) } else { Value::Null };
    let params: Vec<Value> = item
        .params
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
/// The file cannot be read, or is no mission: the error names the line or the item.
pub fn read(path: &Path) -> Result<MissionPlan> {
    let text = std::fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    parse(&text).with_context(|| path.display().to_string())
}

fn parse(text: &str) -> Result<MissionPlan> {
    let text = text.trim_start_matches('\u{feff}');
    if text.trim_start().starts_with('{') {
        return parse_plan(text);
    }
    let mut lines = text.lines();
    if lines.next().map(str::trim) != Some(WPL) {
        bail!("line 1: neither a .plan nor `{WPL}`");
    }
    let mut items = Vec::new();
    for (k, line) in lines.enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        items.push(wpl_item(line).with_context(|| format!("line {}", k + 2))?);
    }
    Ok(MissionPlan { home: None, items })
}

fn wpl_item(line: &str) -> Result<Item> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [_, current, frame, command, p1, p2, p3, p4, x, y, z, auto] = words[..] else {
        bail!("{} columns in place of 12", words.len());
    };
    let number = |text: &str| text.parse::<f64>().with_context(|| format!("`{text}` is no number"));
    let whole = |text: &str| text.parse::<u16>().with_context(|| format!("`{text}` is no whole number"));
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

#[derive(Debug, Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
struct PlanFile {
    file_type: String,
    mission: PlanMission,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
struct PlanMission {
    planned_home_position: Option<Vec<f64>>,
    items: Vec<PlanItem>,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
struct PlanItem {
    r#type: String,
    complex_item_type: Option<String>,
    command: Option<u16>,
    frame: Option<u8>,
    auto_continue: Option<bool>,
    params: Option<Vec<Option<f64>>>,
}

fn parse_plan(text: &str) -> Result<MissionPlan> {
    let file: PlanFile = serde_json::from_str(text)?;
    if file.file_type != "Plan" {
        bail!("its fileType is `{}`, not Plan", file.file_type);
    }
    let home = match file.mission.planned_home_position.as_deref() {
        None => None,
        Some(&[x, y, ref z @ ..]) => Some(
            checked(Item {
                frame: FRAME_GLOBAL,
                command: NAV_WAYPOINT,
                current: true,
                autocontinue: true,
                params: [0.0; 4],
                x,
                y,
                z: z.first().copied().unwrap_or(0.0) as f32,
            })
            .context("plannedHomePosition")?,
        ),
        Some(_) => bail!("plannedHomePosition has fewer than 2 numbers"),
    };
    let items = file.mission.items.iter().enumerate();
    let items: Result<Vec<_>> =
        items.map(|(k, item)| plan_item(item).with_context(|| format!("item {k}"))).collect();
    Ok(MissionPlan { home, items: items? })
}

fn plan_item(item: &PlanItem) -> Result<Item> {
    if item.r#type != "SimpleItem" {
        let kind = item.complex_item_type.as_deref().unwrap_or(&item.r#type);
        bail!("`{kind}` is a pattern: save the mission from QGroundControl as waypoints");
    }
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
        assert_eq!(plan.items.len(), 3);
        assert_eq!((plan.items[2].x, plan.items[2].params[1]), (47.3988, 2.5));
        assert_eq!(parse(&plan.to_wpl()).unwrap(), plan);
    }

    #[test]
    fn a_plan_keeps_home_apart_and_comes_back() {
        let flown = parse(SAMPLE).unwrap().items;
        let plan = MissionPlan::downloaded(flown.clone(), true);
        assert_eq!((plan.home, plan.items.len()), (Some(flown[0]), 2));
        let back = parse(&plan.to_plan()).unwrap();
        assert_eq!(back.items_for(true), flown);
        assert_eq!(back.items_for(false).len(), 2);
        assert!(back.items_for(false)[0].current, "somewhere it begins");
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
                "item 0: `survey` is a pattern",
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
