use super::*;

fn panel(points: Vec<(f64, f64)>) -> Chart {
    let series = vec![Series::line("c", 0, points).styled(Style::Dotted)];
    Chart { series, levels: vec![("limit".into(), 2.0)], panel: true, ..Chart::default() }
}

#[test]
fn a_chart_becomes_files_that_are_what_their_names_say() {
    let dir = tempfile::tempdir().unwrap();
    let points = vec![(0.1, 0.5), (1.0, 0.9), (10.0, 1.0)];
    let chart = Chart {
        title: "errors, \"l1\" & <all>".into(),
        x: "error e, px".into(),
        y: "share".into(),
        log_x: true,
        series: vec![
            Series::line("ours", 0, points.clone()),
            Series::line("theirs", 1, points).styled(Style::Cross),
        ],
        ..Chart::default()
    };
    save(&chart, dir.path(), "chart").unwrap();
    let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    let svg = String::from_utf8(read("chart.svg")).unwrap();
    assert!(svg.contains(">theirs</text>") && svg.contains(">error e, px</text>"), "{svg}");
    assert!(svg.contains("<title>errors, &quot;l1&quot; &amp; &lt;all&gt;</title>"), "{svg}");
    assert_eq!(&read("chart.png")[..4], b"\x89PNG");
    assert_eq!(&read("chart.pdf")[..5], b"%PDF-");
    let csv = String::from_utf8(read("chart_points.csv")).unwrap();
    assert_eq!(csv.lines().count(), 7, "{csv}");
    assert!(
        csv.contains("\"errors, \"\"l1\"\" & <all>\",ours,line,0.1,0.5,,,\"error e, px (log)\",share"),
        "{csv}"
    );
    assert!(read("redraw.py").starts_with(b"#!"));
    let error = save(&chart, &dir.path().join("nowhere"), "chart").unwrap_err().to_string();
    assert!(error.contains("chart.svg"), "{error}");
}

#[test]
fn everything_drawn_lies_inside() {
    let mut panel = panel(vec![(2.5, 0.5), (8.0, 1.0)]);
    panel.series[0].band = vec![(2.5, -1.0, 0.6), (8.0, 0.9, 4.0)];
    panel.series.push(Series::line("", 1, vec![(2.5, 3.0)]).styled(Style::Diamond));
    let (x, y) = panel.axes();
    let (x, y) = (x.range, y.range);
    assert!(x.start < 2.5 && x.end > 8.0 && y.start == 0.0 && y.end > 4.0, "{x:?} {y:?}");
}

#[test]
fn a_picture_says_what_it_shows() {
    let text = svg(&panel(vec![(0.0, 1.0), (1.0, 1.5)]));
    assert!(text.starts_with("<svg") && text.contains(">limit</text>") && text.contains("<desc>"), "{text}");
    // Nothing to show is no reason to fail.
    let dir = tempfile::tempdir().unwrap();
    for points in [vec![], vec![(1.0, f64::NAN)], vec![(0.0, 0.0)]] {
        let text = svg(&panel(points.clone()));
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
        save(&panel(points), dir.path(), "empty").unwrap();
    }
}

/// First use, F1: the legend covered the point of the claim.
#[test]
fn the_legend_stands_below_the_plot() {
    let chart = panel(vec![(0.0, 1.0), (1.0, 1.5)]);
    let text = svg(&chart);
    let top = |text: &str| -> f64 {
        text.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
    };
    let without = svg(&Chart { legend: Legend::None, ..chart });
    assert!(top(&text) > top(&without));
    assert!(text.contains(&format!("<g transform=\"translate(0 {:.0})\">", top(&without))), "{text}");
}

#[test]
fn charts_of_a_sheet_share_their_legend() {
    let charts = [panel(vec![(0.0, 1.0)]), panel(vec![(0.0, 2.0)])];
    let text = svg(Sheet { charts: &charts, columns: 2 });
    assert_eq!(text.matches(">c</text>").count(), 1);
}

/// The shadow's lightest contour covered the others, and the obstacle.
#[test]
fn the_first_of_two_areas_lies_above() {
    let area = |grey: u8| {
        let corners = vec![(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)];
        Series::line("", 0, corners).styled(Style::Area).inked([grey; 3])
    };
    let chart = Chart { series: vec![area(10), area(200)], ..Chart::default() };
    let text = svg(&chart);
    assert!(text.find("rgb(200,200,200)").unwrap() < text.find("rgb(10,10,10)").unwrap());
}
