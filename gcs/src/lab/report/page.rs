//! One self-contained HTML page: pictures inline, no request to anywhere; readable on a phone, in light and in
//! dark. Its one script sorts the tables by the column whose head is pressed; without it they stand as they are.

use std::fmt::Write;

use super::rows::{self, VerdictRow};
use super::verdict::Verdict;

/// The page's look. Pictures are drawn on white; in the dark they are turned round.
const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1b1f24;--paper:#fff;--line:#d0d7de;--soft:#57606a;--good:#116329;--bad:#a40e26;--mid:#7d4e00}
@media(prefers-color-scheme:dark){:root{--ink:#e6edf3;--paper:#0d1117;--line:#30363d;--soft:#9aa4af;--good:#56d364;--bad:#ff7b72;--mid:#e3b341}
figure svg{filter:invert(1) hue-rotate(180deg)}}
body{font:16px/1.55 system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1440px;margin:0 auto;padding:1rem}
h1{font-size:1.6rem}h2{font-size:1.25rem;margin-top:2.2rem;border-bottom:1px solid var(--line)}
p,li{max-width:75ch}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,340px),1fr));gap:.8rem}
figure{margin:0}figure svg{width:100%;height:auto}figcaption{color:var(--soft);font-size:.9rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th,td{padding:.25rem .6rem;border-bottom:1px solid var(--line);text-align:right;white-space:nowrap}
th:first-child,td:first-child,td.text{text-align:left}
.verdicts td:nth-child(1){font-weight:600}.verdicts td:nth-child(4),.verdicts td:nth-child(5){text-align:left}
.verdicts td:nth-child(1)::before{display:inline-block;width:1.4em}
.agrees td:nth-child(1){color:var(--good)}.agrees td:nth-child(1)::before{content:\"=\"}
.stronger td:nth-child(1){color:var(--good)}.stronger td:nth-child(1)::before{content:\"+\"}
.weaker td:nth-child(1){color:var(--mid)}.weaker td:nth-child(1)::before{content:\"\\2212\"}
.nothing td:nth-child(1){color:var(--soft)}.nothing td:nth-child(1)::before{content:\"0\"}
.contradicts td:nth-child(1){color:var(--bad)}.contradicts td:nth-child(1)::before{content:\"\\d7\"}
.missing td{color:var(--soft);font-style:italic}
th button{all:unset;cursor:pointer}th button:focus-visible{outline:2px solid}
th[aria-sort=ascending] button::after{content:\" \\25b4\"}th[aria-sort=descending] button::after{content:\" \\25be\"}
pre{overflow-x:auto;font-size:.8rem;border:1px solid var(--line);padding:.6rem}";

/// Numbers sort as numbers, by the first in a cell.
const SCRIPT: &str = "\
for(const table of document.querySelectorAll('table'))table.querySelectorAll('thead th').forEach((head,n)=>{
const button=document.createElement('button');button.type='button';button.textContent=head.textContent;head.replaceChildren(button);
button.onclick=()=>{const up=head.getAttribute('aria-sort')!=='ascending',body=table.tBodies[0];
table.querySelectorAll('thead th').forEach(h=>h.removeAttribute('aria-sort'));
head.setAttribute('aria-sort',up?'ascending':'descending');
const key=row=>{const text=row.cells[n].textContent.trim(),value=parseFloat(text);return Number.isNaN(value)?text:value};
const order=(a,b)=>typeof a===typeof b?(a<b?-1:a>b?1:0):typeof a==='number'?-1:1;
body.append(...[...body.rows].sort((a,b)=>(up?1:-1)*order(key(a),key(b))))}});";

/// A page that grows from top to bottom.
#[derive(Debug, Clone)]
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// An empty page.
    #[must_use]
    pub fn new(title: &str) -> Self {
        Self { title: escape(title), body: String::new() }
    }

    /// A section's head.
    pub fn section(&mut self, title: &str) {
        let _ = writeln!(self.body, "<h2>{}</h2>", escape(title));
    }

    /// A paragraph.
    pub fn text(&mut self, text: &str) {
        let _ = writeln!(self.body, "<p>{}</p>", escape(text));
    }

    /// Claims of the paper, each with its verdict: told by sign and word, so colour is not needed.
    pub fn verdicts(&mut self, rows: &[VerdictRow]) {
        let heads = ["verdict", "paper", "ours [95 %]", "section", "quantity"];
        let heads: String = heads.iter().map(|head| format!("<th scope=\"col\">{head}</th>")).collect();
        let _ = writeln!(
            self.body,
            "<div class=\"wide\"><table class=\"verdicts\"><thead><tr>{heads}</tr></thead><tbody>"
        );
        for row in rows {
            let class = row.verdict().map_or("missing", Verdict::class);
            let _ = write!(self.body, "<tr class=\"{class}\">");
            for cell in [&row.verdict_cell(), &row.paper, &row.ours_cell(), row.section, &row.quantity] {
                let _ = write!(self.body, "<td>{}</td>", escape(cell));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</tbody></table></div>\n");
        self.text(&format!("{}. {}.", rows::counts(rows), rows::UNDECIDED));
    }

    /// Pictures beside each other, or below each other where there is no room; SVG text and caption.
    pub fn figures(&mut self, figures: &[(String, String)]) {
        self.body.push_str("<div class=\"figures\">\n");
        for (svg, caption) in figures {
            let caption = escape(caption);
            let _ = writeln!(self.body, "<figure>{svg}<figcaption>{caption}</figcaption></figure>");
        }
        self.body.push_str("</div>\n");
    }

    /// A table that can be pushed sideways on a narrow screen.
    pub fn table(&mut self, head: &[String], rows: &[Vec<String>]) {
        let cells = |tag: &str, end: &str, cells: &[String]| {
            cells.iter().map(|cell| format!("<{tag}>{}</{end}>", escape(cell))).collect::<String>()
        };
        let head = cells("th scope=\"col\"", "th", head);
        let _ = writeln!(self.body, "<div class=\"wide\"><table><thead><tr>{head}</tr></thead><tbody>");
        for row in rows {
            let _ = writeln!(self.body, "<tr>{}</tr>", cells("td", "td", row));
        }
        self.body.push_str("</tbody></table></div>\n");
    }

    /// Text as it is, folded away.
    pub fn folded(&mut self, title: &str, text: &str) {
        let (title, text) = (escape(title), escape(text));
        let _ = writeln!(self.body, "<details><summary>{title}</summary><pre>{text}</pre></details>");
    }

    /// The whole document.
    #[must_use]
    pub fn html(&self) -> String {
        let Self { title, body } = self;
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}\n</style>\n<main>\n<h1>{title}</h1>\n{body}</main>\n<script>\n{SCRIPT}\n</script>\n</html>\n"
        )
    }
}

/// Text for the inside of an element.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_needs_nothing_else_and_shows_text_as_text() {
        let mut page = Page::new("a < b");
        page.text("<script>1</script> & more");
        page.figures(&[("<svg></svg>".into(), "x".into())]);
        page.table(&["k".into()], &[vec!["<v>".into()]]);
        let html = page.html();
        assert!(
            html.contains("<title>a &lt; b</title>") && html.contains("&lt;script&gt;1&lt;/script&gt; &amp;")
        );
        assert!(html.contains("<svg></svg>") && html.contains("<td>&lt;v&gt;</td>"));
        assert_eq!(html.matches("<script").count(), 1, "that which sorts the tables");
        for outside in ["http", "src=", "@import"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}
