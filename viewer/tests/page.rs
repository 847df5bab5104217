//! The page of an artificial run: its content, what is omitted, its size.
//!
//! The pages stay in the build's temporary folder, for visual inspection.

use std::f64::consts::TAU;

use armarium_values::report::{
    Band, Block, Cell, Cells, Confusion, Figure, Path, PathStyle, Picture, Plan, Requirement, Section,
    Series, StateSpan, Table, TimePlot, Tone,
};
use armarium_viewer::report::{ChainLink, ReportData, render};
use armarium_visionx::RgbImage;
use armarium_visionx::providers::convert::jpeg;

fn span(path: &str, from_s: f64, to_s: f64, outcome: Option<&str>) -> StateSpan {
    StateSpan { path: path.into(), from_s, to_s: Some(to_s), outcome: outcome.map(Into::into) }
}

fn states() -> Vec<StateSpan> {
    let ok = Some("success");
    vec![
        span("Grasp", 0.0, 14.2, ok),
        span("Grasp.Find", 0.0, 1.4, ok),
        span("Grasp.Approach", 1.4, 6.0, ok),
        span("Grasp.Servo", 6.0, 9.5, ok),
        span("Grasp.Close", 9.5, 11.0, Some("failure")),
        span("Grasp.Close", 11.0, 12.4, ok),
        span("Grasp.Lift", 12.4, 14.2, ok),
        span("Learn", 14.2, 46.0, ok),
        span("Adapt", 46.0, 62.0, ok),
        span("Wipe", 62.0, 168.0, None),
        span("Wipe.Execution.Wiping", 62.0, 168.0, None),
        span("Wipe.Coaching.Watching", 62.0, 73.0, None),
        span("Wipe.Coaching.ByForce", 73.0, 84.0, ok),
        span("Wipe.Coaching.Watching", 84.0, 93.0, None),
        span("Wipe.Coaching.ByVision", 93.0, 106.0, ok),
        span("Wipe.Coaching.Watching", 106.0, 168.0, None),
        span("Done", 168.0, 168.0, ok),
    ]
}

fn loop_path(label: &str, style: PathStyle, shift: impl Fn(f64) -> [f64; 2]) -> Path {
    let points = (0..=2000)
        .map(|i| {
            let phase = TAU * f64::from(i) / 2000.0;
            let [dx, dy] = shift(phase);
            [0.28 + 0.05 * libm::cos(phase) + dx, 0.53 + 0.03 * libm::sin(phase) + dy]
        })
        .collect();
    Path { label: label.into(), style, points }
}

fn signal(label: &str, end: f64, f: impl Fn(f64) -> f64) -> Series {
    let t_s: Vec<f64> = (0..(end * 1000.0) as u64).map(|i| i as f64 * 1e-3).collect();
    let y = t_s.iter().map(|t| f(*t)).collect();
    Series { label: label.into(), t_s, y }
}

/// An irregular signal without random numbers.
fn ripple(t: f64) -> f64 {
    libm::sin(t * 91.7) * libm::cos(t * 37.1) + 0.5 * libm::sin(t * 211.3)
}

fn force() -> TimePlot {
    let normal = |t: f64| match t {
        t if t < 47.5 => 0.02 * ripple(t).abs(),
        t if t < 48.0 => 14.0 * libm::sin((t - 47.5) * TAU).abs(),
        t => 8.0 + libm::exp(-(t - 48.0) / 4.0) * 4.0 * libm::sin(t * 3.0) + 0.3 * ripple(t),
    };
    TimePlot {
        title: "Contact force".into(),
        y_label: "normal force, N".into(),
        series: vec![signal("sponge on table (truth)", 168.0, normal)],
        band: Some(Band {
            value: 8.0,
            tolerance: 1.0,
            label: "desired 8 ± 1 N".into(),
            from_s: Some(62.0),
            to_s: None,
        }),
        limits: vec![(25.0, "limit at touchdown".into())],
        marks: [
            (47.5, "touchdown"),
            (62.0, "adapted"),
            (73.0, "push"),
            (74.0, "forced"),
            (93.0, "fist"),
            (166.0, "coach gone"),
        ]
        .map(|(t, name)| (t, name.to_owned()))
        .to_vec(),
        y_range: None,
    }
}

fn joints() -> Vec<TimePlot> {
    let joint = |i: i32| {
        let i = f64::from(i);
        TimePlot {
            title: format!("Shoulder {i} R"),
            y_label: "rad".into(),
            series: vec![signal("position", 168.0, move |t| {
                0.2 * i - 0.6 + 0.3 * libm::sin(TAU * 0.5 * t + i)
            })],
            limits: vec![(-1.2, "limit".into()), (1.4, "limit".into())],
            ..Default::default()
        }
    };
    (1..=7).map(joint).collect()
}

fn wiped() -> Plan {
    let (columns, rows, cell_m) = (160, 120, 0.0025);
    let cells = (0..columns * rows)
        .map(|i| {
            let x = 0.1 + (i % columns) as f64 * cell_m - 0.28;
            let y = 0.4 + (i / columns) as f64 * cell_m - 0.53;
            let off = (libm::hypot(x / 0.05, y / 0.03) - 1.0).abs();
            match off {
                _ if off < 0.5 && x > 0.055 && y > 0.0 => 2,
                _ if off < 0.5 => 1,
                _ if off < 0.6 => 3,
                _ => 0,
            }
        })
        .collect();
    let kinds = [("cleaned", Tone::Good), ("missed", Tone::Bad), ("beside", Tone::Neutral)];
    let kinds = kinds.map(|(name, tone)| (name.to_owned(), tone)).to_vec();
    let points = vec![[0.2, 0.5], [0.25, 0.52]];
    Plan {
        title: "Wiped area".into(),
        x_label: "x, m".into(),
        y_label: "y, m".into(),
        cells: Some(Cells { origin: [0.1, 0.4], cell_m, columns, kinds, cells }),
        paths: vec![Path { label: "path of the hand".into(), style: PathStyle::Overlay, points }],
    }
}

fn picture(caption: &str) -> Picture {
    let (width, height) = (320_u32, 240_u32);
    let data = (0..width * height)
        .flat_map(|i| {
            let (x, y) = (i % width, i / width);
            if x.abs_diff(160) + y.abs_diff(120) < 40 {
                [240, 210, 40]
            } else {
                [150, 115 + (y / 8) as u8, 80]
            }
        })
        .collect();
    let image = RgbImage::from_rgb(width, height, data).expect("the size fits");
    let data = jpeg(&image).expect("a small image encodes");
    Picture { caption: caption.into(), data, media_type: "image/jpeg".into() }
}

fn figures() -> Vec<Figure> {
    let figure = |group: &str, name: &str, value, unit: &str, requirement| Figure {
        group: group.into(),
        name: name.into(),
        value,
        unit: unit.into(),
        requirement,
        digits: 1,
    };
    vec![
        figure("Grasp", "position error", Some(6.3), "mm", Requirement::AtMost(15.0)),
        figure("Force", "mean", Some(7.97), "N", Requirement::Shown),
        figure("Force", "contact lost", None, "s", Requirement::AtMost(0.0)),
        figure("Wiping", "wiped fraction", Some(94.3), "%", Requirement::AtLeast(95.0)),
        figure(
            "Coaching 1: push",
            "kept after two cycles",
            Some(95.0),
            "%",
            Requirement::Between(80.0, 110.0),
        ),
    ]
}

fn coaching() -> Table {
    let mut table = Table::new(&["Coach", "#At", "#Moved the motion", "Entity", "#Place"]);
    let place = Cell::Numbers { values: vec![0.351, -0.5, 1.0], unit: "m".into(), digits: 3 };
    let row = |kind: &str, at_s, moved, place| {
        let entity = Cell::Code("bob.bob/<sponge>".into());
        vec![
            Cell::Text(kind.into()),
            Cell::number(at_s, "s", 1),
            Cell::optional(moved, "mm", 1),
            entity,
            place,
        ]
    };
    table.rows = vec![row("push", 73.0, Some(31.0), place), row("open_hand", 150.0, None, Cell::Absent)];
    table
}

fn success() -> ReportData {
    let shift = |at: f64, by: [f64; 2]| {
        move |phase: f64| {
            let near = (libm::cos(phase - at) - 1.0) * 6.0;
            by.map(|b| b * libm::exp(near))
        }
    };
    let facts = [
        ("World", "kitchen"),
        ("Seed", "1"),
        ("Simulated", "168.0 s"),
        ("On the wall", "61.3 s"),
        ("Real-time factor", "2.74"),
        ("Trace", "9f2c41d07be1"),
    ];
    let table = vec![[-0.25, 0.25], [0.75, 0.25], [0.75, 0.95], [-0.25, 0.95], [-0.25, 0.25]];
    let paths = Plan {
        title: "Paths over the table".into(),
        paths: vec![
            Path { label: "table".into(), style: PathStyle::Outline, points: table },
            loop_path("demonstrated", PathStyle::Reference, |_| [0.0; 2]),
            loop_path("learned", PathStyle::Line, |p| [0.0015 * libm::sin(3.0 * p), 0.001]),
            loop_path("after push", PathStyle::Line, shift(TAU / 4.0, [0.0, 0.031])),
            loop_path("after fist", PathStyle::Line, shift(TAU * 0.75, [0.0, -0.021])),
        ],
        ..Plan::default()
    };
    let speed = TimePlot {
        title: "Speed of the motion".into(),
        y_label: "frequency, Hz".into(),
        series: vec![
            signal("executed", 168.0, |t| {
                if t < 62.0 { f64::NAN } else { 0.5 - 0.25 * libm::exp(-(t - 98.0).powi(2) / 20.0) }
            }),
            signal("learned", 168.0, |t| if t < 14.2 { f64::NAN } else { 0.5 }),
        ],
        ..Default::default()
    };
    let confusion = Confusion {
        names: ["fist", "open_hand", "point_one", "none"].map(str::to_owned).to_vec(),
        rows: vec![
            ("fist".into(), vec![98, 0, 0, 3]),
            ("open_hand".into(), vec![0, 101, 0, 0]),
            ("none".into(), vec![0, 0, 2, 204]),
        ],
    };
    let captions =
        ["the sponge, found at 0.4 s", "the coach's tool, followed at 22 s", "a fist, seen at 94 s"];
    let log = ["00:00.0 Grasp: looking for <sponge>", "00:14.2 Learn: the coach begins"];
    ReportData {
        title: "Wiping".into(),
        subtitle: "Learn a wiping motion from a coach, fit it to the table, then let the coach change it."
            .into(),
        outcome: "success".into(),
        facts: facts.map(|(a, b)| (a.to_owned(), b.to_owned())).to_vec(),
        sections: vec![
            Section::new(
                "Figures",
                "Measured against the simulator's truth.",
                vec![Block::Figures(figures())],
            ),
            Section::new("States", "", vec![Block::Gantt(states())]),
            Section::new("Paths", "", vec![Block::Plan(paths)]),
            Section::new("Contact force", "", vec![Block::Plot(force())]),
            Section::new("Speed of the motion", "", vec![Block::Plot(speed)]),
            Section::new("Wiped area", "", vec![Block::Plan(wiped())]),
            Section::new("Coaching", "How far.", vec![Block::Table(coaching())]),
            Section::new("Gestures", "", vec![Block::Confusion(confusion)]),
            Section::new("Joints", "", vec![Block::SmallPlots(joints())]),
            Section::new("What the cameras saw", "", vec![Block::Pictures(captions.map(picture).to_vec())]),
            Section::new("Log", "", vec![Block::Lines(log.map(str::to_owned).to_vec())]),
        ],
        ..Default::default()
    }
}

fn leave(name: &str, page: &str) {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR"));
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(folder.join(name), page))
        .expect("the build's folder can be written");
}

/// Every `<svg ...>` of the page is closed and every attribute quoted, so an XML reader accepts it.
fn balanced(page: &str) {
    for tag in ["svg", "section", "table", "tr", "div", "figure", "main", "text", "rect"] {
        let opened = page.matches(&format!("<{tag} ")).count() + page.matches(&format!("<{tag}>")).count();
        assert_eq!(opened, page.matches(&format!("</{tag}>")).count(), "<{tag}> opened and closed");
    }
}

#[test]
fn a_full_page_has_every_section_nothing_from_elsewhere_and_a_bounded_size() {
    let page = render(&success());
    leave("report_success.html", &page);
    for title in [
        "Figures",
        "States",
        "Paths",
        "Contact force",
        "Speed of the motion",
        "Wiped area",
        "Coaching",
        "Gestures",
        "Joints",
        "What the cameras saw",
        "Log",
    ] {
        assert!(page.contains(&format!("<h2>{title}</h2>")), "{title}");
    }
    assert!(page.len() < 1_500_000, "{} bytes", page.len());
    assert_eq!(page.matches("http").count(), page.matches("http://www.w3.org/2000/svg").count());
    assert!(!page.contains("<script") && !page.contains("NaN") && page.contains("&lt;sponge&gt;"));
    assert!(page.contains("✗ missed") && page.contains("simulator&#39;s truth. 2 of 4 met."));
    for cell in
        ["0.351, −0.500, 1.000\u{a0}m", "<code>bob.bob/&lt;sponge&gt;</code>", "<td class=\"n\">–</td>"]
    {
        assert!(page.contains(cell), "{cell}");
    }
    balanced(&page);
}

#[test]
fn a_failed_run_says_why_and_through_which_states() {
    let data = ReportData {
        outcome: "failure".into(),
        reason: Some(
            "No object of the sponge's colour was seen from 4 directions; is it on the table?".into(),
        ),
        failure_chain: vec![
            ChainLink { state: "Grasp.Find".into(), reason: Some("after 3 tries".into()) },
            ChainLink { state: "Grasp".into(), reason: None },
            ChainLink { state: "Wiping".into(), reason: None },
        ],
        sections: vec![
            Section::new(
                "States",
                "",
                vec![Block::Gantt(vec![
                    span("Grasp", 0.0, 12.0, Some("failure")),
                    span("Grasp.Find", 0.0, 12.0, Some("failure")),
                ])],
            ),
            Section::new("Figures", "None.", vec![Block::Figures(Vec::new()), Block::Plan(Plan::default())]),
            Section::new(
                "Joints",
                "None.",
                vec![Block::SmallPlots(Vec::new()), Block::Table(Table::default())],
            ),
        ],
        ..success()
    };
    let page = render(&data);
    leave("report_failure.html", &page);
    let reason = page.find("No object of the sponge&#39;s colour").expect("the reason is shown");
    assert!(reason < page.find("<h2>States</h2>").expect("the states are shown"));
    assert!(page.contains("<li><code>Grasp.Find</code> <span>after 3 tries</span></li>"));
    for absent in ["<h2>Figures", "<h2>Paths", "<h2>Wiped", "<h2>Joints"] {
        assert!(!page.contains(absent), "{absent}");
    }
    balanced(&page);
}

#[test]
fn nothing_at_all_is_still_a_page() {
    let page = render(&ReportData::default());
    assert!(page.contains("Why it did not succeed") && page.ends_with("</html>\n"));
    balanced(&page);
}

#[test]
fn hostile_numbers_and_texts_do_no_harm() {
    let mut data = success();
    data.title = "<script>alert(1)</script>".into();
    let hostile_path = Path { points: vec![[f64::NAN, 0.0], [f64::INFINITY, 1.0]], ..Path::default() };
    let hostile_plot = TimePlot {
        series: vec![Series { label: "x".into(), t_s: vec![0.0, f64::NAN, 2.0], y: vec![f64::INFINITY] }],
        band: Some(Band { value: f64::NAN, tolerance: 1.0, label: String::new(), from_s: None, to_s: None }),
        marks: vec![(f64::NAN, "never".into())],
        y_range: Some([1.0, 1.0]),
        ..Default::default()
    };
    let cells = wiped().cells.map(|cells| Cells { cell_m: f64::NAN, ..cells });
    let ragged = Table { rows: vec![vec![], vec![Cell::number(f64::NAN, "m", 900)]], ..coaching() };
    data.sections.push(Section::new(
        "<script>",
        "",
        vec![
            Block::Plan(Plan { paths: vec![hostile_path], ..Plan::default() }),
            Block::Plot(hostile_plot),
            Block::Plan(Plan { cells, ..wiped() }),
            Block::Gantt(vec![span("..", 0.0, f64::NAN, None), span("", f64::NAN, f64::INFINITY, None)]),
            Block::Table(ragged),
        ],
    ));
    let page = render(&data);
    assert!(!page.contains("<script") && !page.contains("=\"NaN") && !page.contains("=\"inf"));
}
