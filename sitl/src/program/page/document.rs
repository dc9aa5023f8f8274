//! The page as one file: styles and scripts inside, and with a flight's lines inside it is `flight.html`, which
//! opens without a server and without a network.

use std::borrow::Cow;

use include_dir::{Dir, include_dir};

use super::feed::{FeedLine, LineWeight};

/// The page's files.
static FILES: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/src/program/page/site");

/// Bytes of a whole `flight.html`: one can mail it.
pub const LIMIT: usize = 1_950_000;

/// Where the lines stand; the page reads them from there.
const LINES: &str = "<script type=\"application/x-ndjson\" id=\"flight\">";

/// Largest stride at which pictures and beliefs are left out.
const WIDEST: u64 = 1 << 20;

/// The page with its styles and scripts inside.
#[must_use]
pub fn page() -> String {
    let Some(index) = text("index.html") else {
        return "<!doctype html><title>gcs</title><p>This build has no page; /events has the lines.</p>"
            .into();
    };
    let styled = inlined(index, "<link ", ">", "href=", |name| {
        let text = text(name)?;
        Some(format!("<style>\n{text}\n</style>"))
    });
    inlined(&styled, "<script ", "</script>", "src=", |name| {
        let text = text(name)?;
        // A text that ends the element ends the script.
        Some(format!("<script>\n{}\n</script>", text.replace("</script", "<\\/script")))
    })
}

/// The page with these lines inside, smaller than [`LIMIT`]: pictures, beliefs and fields are thinned out until
/// it is.
#[must_use]
pub fn flight(lines: &[FeedLine]) -> String {
    let page = page();
    let room = LIMIT.saturating_sub(page.len() + LINES.len() + 64);
    let mut stride = 1;
    let mut kept = thinned(lines, stride);
    while size(&kept) > room && stride < WIDEST {
        stride *= 2;
        kept = thinned(lines, stride);
    }
    // Of a flight that is too long even so, the end is shown.
    while size(&kept) > room && !kept.is_empty() {
        let half = kept.len() / 2;
        let mut n = 0;
        kept.retain(|line| {
            n += 1;
            n > half || line.weight == LineWeight::Kept
        });
        if half == 0 {
            break;
        }
    }
    let text: Vec<&str> = kept.iter().map(|line| &*line.text).collect();
    // `<` never ends a script element early, and is the same character in JSON.
    let text = text.join("\n").replace('<', "\\u003c");
    let block = format!("{LINES}\n{text}\n</script>\n");
    match page.rfind("</head>") {
        Some(at) => format!("{}{block}{}", &page[..at], &page[at..]),
        None => page + &block,
    }
}

/// The lines inside a `flight.html`; `None` if it is none.
#[must_use]
pub fn lines_of(html: &str) -> Option<Vec<String>> {
    let (_, after) = html.split_once(LINES)?;
    let (block, _) = after.split_once("</script>")?;
    Some(block.lines().filter(|line| !line.is_empty()).map(str::to_owned).collect())
}

fn size(lines: &[&FeedLine]) -> usize {
    lines.iter().map(|line| line.text.len() + 1).sum()
}

/// Of pictures, beliefs and fields every `stride`-th; everything else whole.
fn thinned(lines: &[FeedLine], stride: u64) -> Vec<&FeedLine> {
    let mut fields = 0_u64;
    let mut is_kept = |line: &FeedLine| match line.weight {
        LineWeight::Bulk => line.tick.is_multiple_of(stride),
        LineWeight::Field => {
            fields += 1;
            (fields - 1).is_multiple_of(stride)
        }
        LineWeight::Line | LineWeight::Kept => true,
    };
    lines.iter().filter(|line| is_kept(line)).collect()
}

/// A text file of the page.
fn text(name: &str) -> Option<&'static str> {
    FILES.get_file(name.trim_start_matches("./"))?.contents_utf8()
}

/// `html` with each element from `begin` to `end` whose `key` names a file replaced by what `element` makes of
/// the name.
fn inlined(
    html: &str,
    begin: &str,
    end: &str,
    key: &str,
    element: impl Fn(&str) -> Option<String>,
) -> String {
    let mut out = String::with_capacity(html.len());
    let mut rest = html;
    while let Some(at) = rest.find(begin) {
        let (before, from) = rest.split_at(at);
        out.push_str(before);
        let Some(length) = from.find(end).map(|at| at + end.len()) else {
            rest = from;
            break;
        };
        let (old, after) = from.split_at(length);
        let made = attribute(old, key).and_then(&element);
        out.push_str(&made.map_or(Cow::Borrowed(old), Cow::Owned));
        rest = after;
    }
    out + rest
}

/// The value of an attribute of the element at the beginning of `element`.
fn attribute<'a>(element: &'a str, key: &str) -> Option<&'a str> {
    let head = element.split('>').next()?;
    let value = head.split_once(key)?.1;
    let quoted = value.strip_prefix('"').map(|v| v.split('"').next());
    quoted.unwrap_or_else(|| value.split([' ', '/']).next())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn line(tick: u64, weight: LineWeight, text: &str) -> FeedLine {
        FeedLine { number: 0, weight, tick, text: Arc::from(text) }
    }

    #[test]
    fn the_page_names_no_other_file() {
        let page = page();
        for outside in ["<link rel=\"stylesheet\" href=", "<script src=", "http://", "https://"] {
            let named = page.match_indices(outside).map(|(at, _)| &page[at..(at + 60).min(page.len())]);
            // Names of XML formats and licences are no addresses that are asked for.
            let asked: Vec<_> =
                named.filter(|text| !text.contains("www.w3.org") && !text.contains("github.com")).collect();
            assert!(asked.is_empty(), "{asked:?}");
        }
    }

    #[test]
    fn elements_that_name_a_known_file_are_replaced_and_others_stay() {
        let html = "<a><link rel=stylesheet href=a.css><script src=\"b.js\"></script><script>x</script>";
        let out = inlined(html, "<link ", ">", "href=", |name| Some(format!("[{name}]")));
        assert!(out.starts_with("<a>[a.css]<script"), "{out}");
        let out = inlined(html, "<script ", "</script>", "src=", |name| (name == "b.js").then(|| "B".into()));
        assert!(out.ends_with("B<script>x</script>"), "{out}");
    }

    #[test]
    fn a_long_flight_is_thinned_out_and_keeps_every_interval() {
        let picture = "p".repeat(20_000);
        let mut lines = vec![line(0, LineWeight::Kept, "hello")];
        for n in 0..500 {
            lines.push(line(0, LineWeight::Line, &format!("{{\"tick\":{n}}}")));
            lines.push(line(n, LineWeight::Bulk, &picture));
            lines.push(line(n, LineWeight::Bulk, &picture));
        }
        let html = flight(&lines);
        assert!(html.len() < 2_000_000, "{}", html.len());
        assert!((0..500).all(|n| html.contains(&format!("{{\"tick\":{n}}}"))));
        assert!(html.contains(&picture) && html.contains("hello"));
    }

    #[test]
    fn no_text_of_a_line_ends_the_script() {
        let html = flight(&[line(0, LineWeight::Line, "{\"text\":\"</script><b>\"}")]);
        assert!(html.contains("\\u003c/script>\\u003cb>"));
        assert_eq!(lines_of(&html).unwrap(), ["{\"text\":\"\\u003c/script>\\u003cb>\"}"]);
        assert_eq!(lines_of("<html>"), None);
    }
}
