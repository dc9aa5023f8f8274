//! A figure as files: the SVG, PDF and PNG made from it with a font of our own, its numbers as long-form CSV, and
//! a script that draws them again.

use std::fmt::Write;
use std::path::Path;
use std::sync::{Arc, OnceLock};

use resvg::{tiny_skia, usvg};

use super::{Chart, PlotError, Series, Sheet, svg};

/// What follows the stem in the names of a figure's files, beside the script.
pub const ENDINGS: [&str; 4] = [".svg", ".pdf", ".png", "_points.csv"];

/// Pixels of the PNG for one px of the SVG.
const SCALE: f32 = 1.5;

/// The script, and its name.
const SCRIPT: (&str, &str) = ("redraw.py", include_str!("redraw.py"));

/// Saves a figure as `{stem}.svg`, `.pdf`, `.png` and `{stem}_points.csv` in `dir`, and beside them the script that draws the
/// figure again from the CSV.
///
/// # Errors
/// If one of them cannot be drawn or written; the error names it.
pub fn save<'a>(sheet: impl Into<Sheet<'a>>, dir: &Path, stem: &str) -> Result<(), PlotError> {
    let sheet = sheet.into();
    let write = |name: String, bytes: &[u8]| {
        let path = dir.join(name);
        std::fs::write(&path, bytes).map_err(|e| PlotError { path, message: e.to_string() })
    };
    let text = svg(sheet);
    write(format!("{stem}.svg"), text.as_bytes())?;
    let failed =
        |extension, message: String| PlotError { path: dir.join(format!("{stem}.{extension}")), message };
    let tree = tree(&text).map_err(|e| failed("png", e))?;
    write(format!("{stem}.png"), &png(&tree).map_err(|e| failed("png", e))?)?;
    write(format!("{stem}.pdf"), &pdf(&tree).map_err(|e| failed("pdf", e))?)?;
    write(format!("{stem}_points.csv"), csv(sheet.charts).as_bytes())?;
    write(SCRIPT.0.into(), SCRIPT.1.as_bytes())
}

/// The picture with its words shaped in the font inside the program.
fn tree(text: &str) -> Result<usvg::Tree, String> {
    static FONTS: OnceLock<Arc<usvg::fontdb::Database>> = OnceLock::new();
    let fonts = FONTS.get_or_init(|| {
        let mut fonts = usvg::fontdb::Database::new();
        fonts.load_font_data(dejavu::sans::regular().to_vec());
        fonts.set_sans_serif_family("DejaVu Sans");
        Arc::new(fonts)
    });
    let options =
        usvg::Options { fontdb: Arc::clone(fonts), font_family: "DejaVu Sans".into(), ..Default::default() };
    usvg::Tree::from_str(text, &options).map_err(|e| e.to_string())
}

fn png(tree: &usvg::Tree) -> Result<Vec<u8>, String> {
    let size = tree.size().to_int_size().scale_by(SCALE).ok_or("no size")?;
    let mut pixels = tiny_skia::Pixmap::new(size.width(), size.height()).ok_or("too large")?;
    resvg::render(tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|e| e.to_string())
}

fn pdf(tree: &usvg::Tree) -> Result<Vec<u8>, String> {
    let page = svg2pdf::PageOptions { dpi: 96.0 };
    svg2pdf::to_pdf(tree, svg2pdf::ConversionOptions::default(), page).map_err(|e| e.to_string())
}

/// All that is drawn, one row a point: panel, series, style, x, y, the band's low and high, and the names of the
/// axes.
fn csv(charts: &[Chart]) -> String {
    let mut text = String::from("panel,series,style,x,y,low,high,x_axis,y_axis\n");
    for chart in charts {
        let axis = |name: &str, log: bool| quoted(&format!("{name}{}", if log { " (log)" } else { "" }));
        let ends = format!("{},{}", axis(&chart.x, chart.log_x), axis(&chart.y, chart.log_y));
        let panel = quoted(&chart.title);
        for (n, series) in chart.series.iter().enumerate() {
            let name = if series.name.is_empty() { format!("{n}") } else { series.name.clone() };
            let start = format!("{panel},{},{}", quoted(&name), series.style.key());
            rows(&mut text, series, &start, &ends);
        }
        let (left, right) = (chart.axes().0.range.start, chart.axes().0.range.end);
        for (name, level) in &chart.levels {
            for x in [left, right] {
                let _ = writeln!(text, "{panel},{},level,{x},{level},,,{ends}", quoted(name));
            }
        }
    }
    text
}

fn rows(text: &mut String, series: &Series, start: &str, ends: &str) {
    for (n, (x, y)) in series.points.iter().enumerate() {
        let (low, high) = match series.band.get(n) {
            Some((_, low, high)) => (low.to_string(), high.to_string()),
            None => Default::default(),
        };
        let _ = writeln!(text, "{start},{x},{y},{low},{high},{ends}");
    }
}

/// A cell that may hold commas.
fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}
