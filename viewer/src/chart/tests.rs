//! Charts as pictures: nothing touches what it should not, everything is included, texts can be read.

use std::collections::BTreeSet;
use std::path::Path;

use armarium_runtime::chart::{Outline, OutlineKind, load_text};

use super::font::{SIZE, width};
use super::geometry::{LineStep, Point, Rect, Size};
use super::scene::{ChartPicture, DrawnShape, PALETTE};
use super::{DrawError, Format, Theme, Unfold, fold, levels, levels_that_fit, render, unfold};

const CHART: &str = "statechart: Demo
initial: A
states:
  A:
    enter: [{log: hello}]
    transitions: {go: {target: B.Right.R2, if: 'locals.n > 1'}, stay: {do: [{raise: x}]}, all: {target: [B.Left.L2, B.Right.R2]}}
  B:
    parallel:
      Left:
        initial: L1
        states:
          H: {history: deep, default: L1}
          L1: {transitions: {go: L2}}
          L2: {transitions: {go: L1, out: A, over: R2}}
      Right:
        initial: R1
        states: {R1: {after: {2s: R2}}, R2: {}}
    transitions: {success: End, again: B, failure: Bad}
  End: {final: success}
  Bad: {final: failure}
";

fn outline(text: &str) -> Outline {
    let library = load_text("test.yaml", text, &[]);
    Outline::of(&library.charts[&library.root])
}

fn text_of(outline: &Outline, format: Format) -> String {
    let file = render(outline, format, Theme::Auto).expect("only PNG can fail");
    String::from_utf8(file).expect("it is text")
}

/// The charts that ship, by name.
fn shipped() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../statecharts");
    let entries =
        std::fs::read_dir(folder).expect("the folder is there").map(|e| e.expect("it can be read").path());
    let charts = entries.filter(|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.ends_with(".yaml") && !name.ends_with(".test.yaml") && !name.ends_with(".world.yaml")
    });
    let read = |path: std::path::PathBuf| {
        let text = std::fs::read_to_string(&path).expect("the chart can be read");
        (path.file_name().expect("a file").to_string_lossy().into_owned(), text)
    };
    let mut charts: Vec<_> = charts.map(read).collect();
    charts.sort();
    assert!(charts.len() >= 5);
    charts
}

/// A chart of about 60 states in four levels with regions, of which almost all can fail.
fn sixty_states() -> String {
    fn chain(pad: usize, name: &str, count: usize, text: &mut String) {
        let pad = " ".repeat(pad);
        text.push_str(&format!("{pad}initial: {name}0\n{pad}states:\n"));
        for n in 0..count {
            let last = n + 1 == count;
            let next = if last { format!("{name}Ended, again: {name}0") } else { format!("{name}{}", n + 1) };
            text.push_str(&format!(
                "{pad}  {name}{n}: {{skill: MoveTcp, transitions: {{success: {next}, failure: Failed}}}}\n"
            ));
        }
        text.push_str(&format!("{pad}  {name}Ended: {{final: success}}\n"));
    }
    let mut text = String::from("statechart: Large\ninitial: Stage0\nstates:\n");
    for stage in 0..6 {
        text.push_str(&format!("  Stage{stage}:\n"));
        if stage % 2 == 0 {
            chain(4, &format!("LineStep{stage}_"), 7, &mut text);
        } else {
            text.push_str("    parallel:\n      Left:\n");
            chain(8, &format!("Left{stage}_"), 3, &mut text);
            text.push_str("      Right:\n        initial: Look\n        states:\n");
            text.push_str(
                "          Look: {skill: LookAt, transitions: {success: Track, failure: Failed}}\n",
            );
            text.push_str("          Track:\n");
            chain(12, &format!("Track{stage}_"), 2, &mut text);
            text.push_str("            transitions: {success: Look, failure: Failed}\n");
        }
        let next = if stage == 5 { "Done".into() } else { format!("Stage{}", stage + 1) };
        let back = if stage > 1 { format!(", retry: Stage{}", stage - 1) } else { String::new() };
        text.push_str(&format!("    after: {{{}s: Failed}}\n", 60 + stage));
        text.push_str(&format!("    transitions: {{success: {next}, failure: Failed{back}}}\n"));
    }
    text + "  Done: {final: success}\n  Failed: {final: failure}\n"
}

/// A chart with many states at one level, or many levels; from each state two transitions, many of them back.
fn tangle(wide: usize, deep: usize) -> String {
    fn level(text: &mut String, wide: usize, deep: usize, indent: usize) {
        let pad = " ".repeat(indent);
        text.push_str(&format!("{pad}initial: S0\n{pad}states:\n"));
        for n in 0..wide {
            let (to, back) = ((n + 1) % wide, (n * 7 + 3) % wide);
            text.push_str(&format!(
                "{pad}  S{n}:\n{pad}    transitions: {{next_event: S{to}, other{n}: S{back}}}\n"
            ));
            if n == 1 && deep > 0 {
                level(text, wide, deep - 1, indent + 4);
            }
        }
    }
    let mut text = String::from("statechart: Tangle\n");
    level(&mut text, wide, deep, 0);
    text
}

/// One state that starts many others, which all come back.
fn star(rays: usize) -> String {
    let each = |n| format!("  Ray{n}: {{transitions: {{done: Hub}}}}\n");
    let starts: Vec<String> = (0..rays).map(|n| format!("start{n}: Ray{n}")).collect();
    let rays: String = (0..rays).map(each).collect();
    format!(
        "statechart: Star\ninitial: Hub\nstates:\n  Hub: {{transitions: {{{}}}}}\n{rays}",
        starts.join(", ")
    )
}

fn all_charts() -> Vec<(String, String)> {
    let made = [
        ("demo", CHART.to_owned()),
        ("sixty states", sixty_states()),
        ("star", star(20)),
        ("wide", tangle(20, 0)),
        ("deep", tangle(3, 12)),
        ("both", tangle(6, 3)),
    ];
    shipped().into_iter().chain(made.map(|(name, text)| (name.to_owned(), text))).collect()
}

/// Tolerance for rounding and half the width of a line, px.
const SLACK: f64 = 0.8;

fn apart(a: Rect, b: Rect) -> bool {
    let beside = a.right() <= b.x + SLACK || b.right() <= a.x + SLACK;
    beside || a.bottom() <= b.y + SLACK || b.bottom() <= a.y + SLACK
}

fn contains(outer: Rect, inner: Rect) -> bool {
    inner.x >= outer.x - SLACK
        && inner.y >= outer.y - SLACK
        && inner.right() <= outer.right() + SLACK
        && inner.bottom() <= outer.bottom() + SLACK
}

fn strictly_inside(r: &Rect, (x, y): Point) -> bool {
    x > r.x + SLACK && x < r.right() - SLACK && y > r.y + SLACK && y < r.bottom() - SLACK
}

fn strictly_outside(r: &Rect, (x, y): Point) -> bool {
    x < r.x - SLACK || x > r.right() + SLACK || y < r.y - SLACK || y > r.bottom() + SLACK
}

fn bounds(points: &[Point]) -> Rect {
    let least = |f: fn(&Point) -> f64| points.iter().map(f).fold(f64::INFINITY, f64::min);
    let most = |f: fn(&Point) -> f64| points.iter().map(f).fold(f64::NEG_INFINITY, f64::max);
    let (x, y) = (least(|p| p.0), least(|p| p.1));
    Rect { x, y, size: Size { width: most(|p| p.0) - x, height: most(|p| p.1) - y } }
}

/// Points along a line, close to each other.
fn samples(steps: &[LineStep]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    for step in steps {
        let last = points.last().copied().unwrap_or_default();
        let mix = |a: Point, b: Point, t: f64| (a.0 + (b.0 - a.0) * t, a.1 + (b.1 - a.1) * t);
        match *step {
            LineStep::Move(p) => points.push(p),
            LineStep::Line(p) => points.extend((1..=40).map(|n| mix(last, p, f64::from(n) / 40.0))),
            LineStep::Curve(a, b, p) => points.extend((1..=40).map(|n| {
                let t = f64::from(n) / 40.0;
                let (ab, bc, cd) = (mix(last, a, t), mix(a, b, t), mix(b, p, t));
                mix(mix(ab, bc, t), mix(bc, cd, t), t)
            })),
        }
    }
    points
}

/// What touches in a picture that should not.
fn touching(scene: &ChartPicture) -> Vec<String> {
    let (mut texts, mut frames, mut heads, mut lines) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for shape in &scene.shapes {
        match shape {
            DrawnShape::Text { at: (x, y), text, weight, .. } => {
                let size = Size { width: width(text, *weight), height: SIZE };
                texts.push((text.as_str(), Rect { x: *x, y: y - 0.78 * SIZE, size }));
            }
            DrawnShape::Frame { at, .. } => frames.push(*at),
            DrawnShape::Head(corners) => heads.push(bounds(corners)),
            DrawnShape::Line(steps) => lines.push(samples(steps)),
            DrawnShape::Dot((x, y), r) => {
                frames.push(Rect { x: x - r, y: y - r, size: Size { width: 2.0 * r, height: 2.0 * r } });
            }
        }
    }
    let mut found = Vec::new();
    let whole = Rect { x: 0.0, y: 0.0, size: scene.size };
    for (n, (text, at)) in texts.iter().enumerate() {
        let others = texts[n + 1..].iter().filter(|(_, other)| !apart(*at, *other));
        found.extend(others.map(|(other, _)| format!("`{text}` and `{other}`")));
        let boxes = frames.iter().chain([&whole]).filter(|f| !apart(*at, **f) && !contains(**f, *at));
        found.extend(boxes.map(|f| format!("`{text}` and the box {f:?}")));
        found.extend(
            heads.iter().filter(|h| !apart(*at, **h)).map(|h| format!("`{text}` and the head {h:?}")),
        );
        let crossed = lines.iter().filter(|line| line.iter().any(|p| strictly_inside(at, *p)));
        found.extend(crossed.map(|line| format!("`{text}` and the line from {:?}", line[0])));
    }
    for (n, frame) in frames.iter().enumerate() {
        let apart_or_nested =
            |other: &&Rect| apart(*frame, **other) || contains(*frame, **other) || contains(**other, *frame);
        let others = frames[n + 1..].iter().filter(|other| !apart_or_nested(other));
        found.extend(others.map(|other| format!("the boxes {frame:?} and {other:?}")));
        let crossing = lines.iter().filter(|line| {
            line.iter().any(|p| strictly_inside(frame, *p))
                && line.iter().any(|p| strictly_outside(frame, *p))
        });
        found.extend(crossing.map(|line| format!("the box {frame:?} and the line from {:?}", line[0])));
        let cut = heads.iter().filter(|head| !apart(*frame, **head) && !contains(*frame, **head));
        found.extend(cut.map(|head| format!("the box {frame:?} and the head {head:?}")));
    }
    for (n, head) in heads.iter().enumerate() {
        let others = heads[n + 1..].iter().filter(|other| *other != head && !apart(*head, **other));
        found.extend(others.map(|other| format!("the heads {head:?} and {other:?}")));
    }
    found
}

#[test]
fn nothing_touches_what_it_should_not() {
    for (name, text) in all_charts() {
        let scene = ChartPicture::of(&outline(&text));
        assert!(scene.shapes.len() > 10, "{name}");
        assert_eq!(touching(&scene), Vec::<String>::new(), "{name}");
    }
}

#[test]
fn a_label_on_a_box_or_a_line_is_found() {
    let mut scene = ChartPicture::of(&outline(CHART));
    let label = scene.shapes.iter().find(|s| matches!(s, DrawnShape::Text { text, .. } if text == "success"));
    let Some(DrawnShape::Text { at, text, ink, weight }) = label.cloned() else { panic!("there is a label") };
    scene.shapes.push(DrawnShape::Text { at: (at.0 + 3.0, at.1 + 3.0), text: text.clone(), ink, weight });
    scene.shapes.push(DrawnShape::Line(vec![
        LineStep::Move((at.0, at.1 - 20.0)),
        LineStep::Line((at.0 + 20.0, at.1 + 20.0)),
    ]));
    assert!(touching(&scene).len() >= 2);
}

#[test]
fn a_picture_fitted_to_a_screen_has_text_of_eleven_pixels() {
    for (name, text) in shipped().into_iter().chain([("sixty states".to_owned(), sixty_states())]) {
        let outline = outline(&text);
        assert!(name != "sixty states" || (60..=70).contains(&outline.states.len()));
        let width = ChartPicture::of(&outline).size.width;
        assert!(SIZE * 1600.0 / width >= 11.0, "{name} is {width} px wide");
    }
}

/// The texts of a picture, one after the other.
fn texts(outline: &Outline) -> String {
    let scene = ChartPicture::of(outline);
    let texts = scene.shapes.iter().filter_map(|shape| match shape {
        DrawnShape::Text { text, .. } => Some(text.trim()),
        _ => None,
    });
    texts.collect::<Vec<_>>().join(" ")
}

#[test]
fn everything_that_is_written_is_in_the_picture() {
    let texts = texts(&outline(CHART));
    for part in [
        "Demo",
        "L1",
        "H*",
        "enter / log",
        "stay / raise x",
        "go [locals.n > 1] › Right.R2",
        "all → B.Left.L2 + B.Right.R2",
        "after 2s",
        "Left.L2: out",
        "over",
        "again → itself",
        "success",
    ] {
        assert!(texts.contains(part), "{part} in {texts}");
    }
}

#[test]
fn states_that_go_to_a_common_end_name_it_and_have_no_arrow_to_it() {
    let state =
        |n: usize| format!("  S{n}: {{skill: X, after: {{9s: Failed}}, transitions: {{failure: Failed}}}}\n");
    let chart = |count: usize| {
        let states: String = (0..count).map(state).collect();
        outline(&format!("statechart: C\ninitial: S0\nstates:\n{states}  Failed: {{final: failure}}\n"))
    };
    let heads = |outline: &Outline| {
        ChartPicture::of(outline).shapes.iter().filter(|s| matches!(s, DrawnShape::Head(_))).count()
    };
    assert_eq!((heads(&chart(2)), texts(&chart(2)).matches("→ Failed").count()), (3, 0));
    assert_eq!((heads(&chart(3)), texts(&chart(3)).matches("failure, after 9s → Failed").count()), (1, 3));
}

#[test]
fn arrows_to_a_common_target_share_a_head() {
    let heads: BTreeSet<String> = ChartPicture::of(&outline(&star(20)))
        .shapes
        .iter()
        .filter(|shape| matches!(shape, DrawnShape::Head(_)))
        .map(|head| format!("{head:?}"))
        .collect();
    // One for each ray, one for the way back, one for the start.
    assert_eq!(heads.len(), 22);
}

#[test]
fn a_folded_chart_counts_what_it_does_not_show() {
    let whole = outline(CHART);
    let folded = fold(&whole, 1);
    let names: Vec<&str> = folded.states.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["Demo", "A", "B", "End", "Bad"]);
    assert_eq!(folded.states[2].activities, ["7 states inside"]);
    let texts = texts(&folded);
    assert!(texts.contains("Left.L2: out") && texts.contains("go [locals.n > 1]"), "{texts}");
    assert!(!texts.contains("after 2s"), "{texts}");
    assert_eq!(fold(&whole, 9), whole);
}

#[test]
fn a_chart_that_a_chart_uses_is_unfolded_in_its_place() {
    let inner = load_text(
        "inner.yaml",
        "statechart: Inner\ninitial: I\nstates: {I: {transitions: {x: E}}, E: {final: success}}\n",
        &[],
    );
    let text = "statechart: Outer\ninitial: Use\nstates: {Use: {statechart: Inner, transitions: {success: E}}, E: {final: success}}\n";
    for which in ["Use", "Inner", "all"] {
        let mut outer = outline(text);
        let which =
            if which == "all" { Unfold::All } else { Unfold::Named(BTreeSet::from([which.to_owned()])) };
        assert_eq!(unfold(&mut outer, &inner.charts, &which), BTreeSet::new());
        let names: Vec<String> = (1..outer.states.len()).map(|s| outer.path(s)).collect();
        assert_eq!(names, ["Use", "E", "Use.I", "Use.E"]);
        assert_eq!(
            (&outer.states[1].kind, &outer.states[1].activities[0][..]),
            (&OutlineKind::Composite, "chart Inner")
        );
        assert_eq!((outer.transitions[1].source, &outer.transitions[1].targets[..]), (3, &[4][..]));
        assert_eq!(touching(&ChartPicture::of(&outer)), Vec::<String>::new());
    }
    let unknown = Unfold::Named(BTreeSet::from(["Nobody".to_owned()]));
    assert_eq!(unfold(&mut outline(text), &inner.charts, &unknown), BTreeSet::from(["Nobody".to_owned()]));
}

#[test]
fn texts_can_be_read_on_what_is_behind_them_in_both_themes() {
    // Relative luminance and contrast as in WCAG 2.2, which asks for 4.5 for text.
    let luminance = |color: u32| {
        let [_, r, g, b] = color.to_be_bytes().map(|c| {
            let c = f64::from(c) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) }
        });
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let contrast = |a: u32, b: u32| {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    };
    for text in ["text", "soft", "label"] {
        for behind in ["paper", "box", "skill", "chart", "end", "bad"] {
            let of = |name| PALETTE.iter().find(|p| p.0 == name).expect("it has a colour");
            let (a, b) = (of(text), of(behind));
            assert!(contrast(a.1, b.1) >= 4.5 && contrast(a.2, b.2) >= 4.5, "{text} on {behind}");
        }
    }
}

#[test]
fn a_png_has_twice_the_pixels_of_the_picture_and_its_theme() {
    let outline = outline(CHART);
    let size = ChartPicture::of(&outline).size;
    for (theme, paper) in
        [(Theme::Auto, [255, 255, 255]), (Theme::Light, [255, 255, 255]), (Theme::Dark, [20, 23, 29])]
    {
        let file = render(&outline, Format::Png, theme).expect("it is small enough");
        let image = image::load_from_memory(&file).expect("it is an image").into_rgb8();
        assert_eq!(image.dimensions(), (2 * size.width.ceil() as u32, 2 * size.height.ceil() as u32));
        assert_eq!(image.get_pixel(0, 0).0, paper);
        let inked = image.pixels().filter(|p| p.0 != paper).count();
        assert!(inked > 10_000, "{inked}");
    }
}

#[test]
fn a_png_that_nobody_could_read_is_refused() {
    let mut text = String::from("statechart: C\nparallel:\n");
    for n in 0..30_000 {
        text.push_str(&format!("  Region{n}: {{description: x}}\n"));
    }
    let mut wide = outline(&text);
    wide.states[0].activities = vec!["word ".repeat(40); 20_000];
    let error = render(&wide, Format::Png, Theme::Auto).expect_err("it is too large");
    assert!(
        matches!(error, DrawError::TooLarge { .. }) && error.to_string().contains("fold states"),
        "{error}"
    );
}

#[test]
fn svg_has_the_colours_of_its_theme() {
    let write = |theme| {
        let file = render(&outline(CHART), Format::Svg, theme).expect("only PNG can fail");
        String::from_utf8(file).expect("it is text")
    };
    let (auto, light, dark) = (write(Theme::Auto), write(Theme::Light), write(Theme::Dark));
    assert!(auto.contains("prefers-color-scheme") && auto.contains("go [locals.n &gt; 1]"));
    assert!(!light.contains("prefers-color-scheme") && light.contains("--paper:#ffffff"));
    assert!(!dark.contains("#ffffff") && dark.contains("--paper:#14171d"));
}

#[test]
fn the_other_forms_are_as_they_were() {
    insta::assert_snapshot!("mermaid", text_of(&outline(CHART), Format::Mermaid));
    insta::assert_snapshot!("plantuml", text_of(&outline(CHART), Format::PlantUml));
    insta::assert_snapshot!("dot", text_of(&outline(CHART), Format::Dot));
}

#[test]
fn json_names_states_and_transitions() {
    let json: serde_json::Value =
        serde_json::from_str(&text_of(&outline(CHART), Format::Json)).expect("it is JSON");
    assert_eq!(json["states"][1]["name"], "A");
    assert_eq!(json["transitions"][0]["guard"], "locals.n > 1");
}

#[test]
fn boxes_of_states_carry_their_paths() {
    let outline = outline(CHART);
    let svg = text_of(&outline, Format::Svg);
    for state in 1..outline.states.len() {
        let mark = format!(" data-state=\"{}\" ", outline.path(state));
        assert_eq!(svg.matches(&mark).count(), 1, "{mark}");
    }
    assert_eq!(svg.matches("data-state").count(), outline.states.len() - 1);
    let folded = fold(&outline, 1);
    assert_eq!(text_of(&folded, Format::Svg).matches("data-state").count(), 4, "A, B, End, Bad");
    // Charts in charts have the paths that a run tells.
    let library =
        load_text("t.yaml", "statechart: T\ninitial: Grasp\nstates: {Grasp: {statechart: T}}\n", &[]);
    let mut nested = Outline::of(&library.charts["T"]);
    unfold(&mut nested, &library.charts, &Unfold::All);
    assert!(text_of(&nested, Format::Svg).contains("data-state=\"Grasp.Grasp\""));
}

#[test]
fn of_many_levels_those_are_shown_that_fit() {
    let level = |inner: &str, indent: usize| {
        let pad = " ".repeat(indent);
        let one = |n: usize| {
            let next = if n < 5 { format!("S{}", n + 1) } else { "Done".to_owned() };
            format!("{pad}  S{n}:\n{pad}    transitions: {{success: {next}}}\n{inner}")
        };
        let states: String = (0..6).map(one).collect();
        format!("{pad}initial: S0\n{pad}states:\n{states}{pad}  Done: {{final: success}}\n")
    };
    let nested = level(&level(&level("", 8), 4), 0);
    let outline = outline(&format!("statechart: T\n{nested}"));
    assert_eq!((levels(&outline), levels_that_fit(&outline)), (3, Some(2)));
    assert_eq!(levels_that_fit(&fold(&outline, 2)), None);
}

#[test]
fn sixty_states_at_one_level_stand_in_columns_that_fit_a_screen() {
    let size = ChartPicture::of(&outline(&tangle(60, 0))).size;
    assert!(size.width < 1700.0 && size.height < 1700.0, "{size:?}");
}
