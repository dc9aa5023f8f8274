//! Mission files of both kinds as they are read.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use crpl_sitl::link::param_file::excerpt;
use crpl_sitl::program::files;
use serde::Deserialize;

use super::super::item::Item;
use super::{
    DO_JUMP, FENCE_CIRCLE, FENCE_POLYGON, FENCE_RETURN_POINT, FRAME_GLOBAL, FRAME_RELATIVE, MissionPlan,
    NAV_WAYPOINT, RALLY_POINT, WPL, WPL_READ, at,
};

/// Reads a file of either kind.
///
/// # Errors
/// The file cannot be read, or is no mission: the error names the line.
pub fn read(path: &Path) -> Result<MissionPlan> {
    let text = files::read_text(path).with_context(|| format!("reading {}", path.display()))?;
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
    let number =
        |text: &str| text.parse::<f64>().with_context(|| format!("`{}` is no number", excerpt(text)));
    // Some programs write all columns as they write places: 16.000000.
    let whole = |text: &str| -> Result<u16> {
        let value = number(text)?;
        let fits = value.fract() == 0.0 && (0.0..=f64::from(u16::MAX)).contains(&value);
        if fits { Ok(value as u16) } else { bail!("`{}` is no whole number", excerpt(text)) }
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
        ensure!(polygon.len() >= 3, "a polygon has {} corners", polygon.len());
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
