//! Mission files: QGroundControl's `.plan` (JSON) and the older `QGC WPL 110` (text, one item a line).
//!
//! A plan keeps home apart, WPL has it as its first line, as ArduPilot has it as item 0; other autopilots have
//! no home among their items. Jumps name their item by its number in WPL, by its id in a plan; here by its
//! place among the items without home.

mod parse;

pub use parse::{parse, read};

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, ensure};
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

#[cfg(test)]
mod tests;
