//! Charts as pictures: nothing overlaps, everything is included.

use armarium_runtime::chart::{Outline, load_text};

use super::graph::Graph;
use super::measure::{LINE, width};
use super::nested::{Placed, lay_out};
use super::{mermaid, plantuml, svg};

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

/// A chart with many states at one level, or many levels.
fn large(wide: usize, deep: usize) -> String {
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
    let mut text = String::from("statechart: Large\n");
    level(&mut text, wide, deep, 0);
    text
}

/// Rectangles of one level that must not touch: x, y, width, height.
type Rectangle = (f64, f64, f64, f64);

fn apart(a: Rectangle, b: Rectangle) -> bool {
    let slack = 0.01;
    a.0 + a.2 <= b.0 + slack
        || b.0 + b.2 <= a.0 + slack
        || a.1 + a.3 <= b.1 + slack
        || b.1 + b.3 <= a.1 + slack
}

fn check(placed: &Placed) -> usize {
    let mut all: Vec<Rectangle> =
        placed.inside.iter().map(|p| (p.x, p.y, p.size.width, p.size.height)).collect();
    for (arrow, route) in placed.arrows.iter().filter(|(arrow, _)| !arrow.label.is_empty()) {
        let wide = arrow.label.iter().map(|l| width(l)).fold(0.0, f64::max);
        let high = arrow.label.len() as f64 * LINE;
        all.push((route.label.0 - wide / 2.0, route.label.1 - high / 2.0, wide, high));
    }
    for (i, a) in all.iter().enumerate() {
        let (right, bottom) = (placed.x + placed.size.width, placed.y + placed.size.height);
        assert!(
            a.0 >= placed.x && a.1 >= placed.y && a.0 + a.2 <= right + 0.01 && a.1 + a.3 <= bottom + 0.01,
            "{a:?}"
        );
        for b in &all[i + 1..] {
            assert!(apart(*a, *b), "{a:?} and {b:?} in {}", placed.title);
        }
    }
    for (_, route) in &placed.arrows {
        for (x, y) in &route.points {
            let inside = |r: &&Rectangle| {
                *x > r.0 + 0.1 && *x < r.0 + r.2 - 0.1 && *y > r.1 + 0.1 && *y < r.1 + r.3 - 0.1
            };
            let boxes = &all[..placed.inside.len()];
            assert_eq!(boxes.iter().find(inside), None, "a bend of an arrow lies in a box");
        }
    }
    all.len() + placed.inside.iter().map(check).sum::<usize>()
}

#[test]
fn boxes_and_labels_do_not_overlap() {
    for text in [CHART.to_owned(), large(20, 0), large(3, 12), large(6, 3)] {
        let outline = outline(&text);
        assert!(check(&lay_out(&outline, &Graph::of(&outline), 0)) > 10);
    }
}

#[test]
fn everything_that_is_written_is_in_the_picture() {
    let picture = svg(&outline(CHART));
    for part in [
        ">Demo<",
        ">L1<",
        ">H*<",
        "enter / log",
        "stay / raise x",
        "go [locals.n &gt; 1] ▸ Right.R2",
        "all → B.Left.L2 + B.Right.R2",
        "after 2s",
        "Left.L2: out",
        "over",
        "again → itself",
        "success",
    ] {
        assert!(picture.contains(part), "{part}");
    }
}

#[test]
fn the_other_forms_are_as_they_were() {
    insta::assert_snapshot!("mermaid", mermaid(&outline(CHART)));
    insta::assert_snapshot!("plantuml", plantuml(&outline(CHART)));
}
