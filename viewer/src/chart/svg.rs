//! A picture as SVG.

use std::fmt::Write as _;

use crate::markup::escape;

use super::Theme;
use super::font::{SIZE, Weight, width};
use super::geometry::LineStep;
use super::scene::{ChartPicture, DrawnShape, Ink, PALETTE};

/// Writes a picture as a file of its own, with its style sheet.
pub(super) fn svg(scene: &ChartPicture, theme: Theme) -> String {
    let (width, height) = (scene.size.width.ceil(), scene.size.height.ceil());
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" role=\"img\">\n<title>{}</title>\n<style>{}</style>\n\
         <rect class=\"paper\" width=\"{width}\" height=\"{height}\"/>\n",
        escape(&scene.title),
        style(theme)
    );
    scene.shapes.iter().for_each(|each| shape(each, &mut out));
    out.push_str("</svg>\n");
    out
}

fn style(theme: Theme) -> String {
    let colours = |dark: bool| {
        let each = PALETTE
            .iter()
            .map(|(name, light, night)| format!("--{name}:#{:06x}", if dark { night } else { light }));
        format!("svg{{{}}}", each.collect::<Vec<_>>().join(";"))
    };
    let mut out = colours(theme == Theme::Dark);
    if theme == Theme::Auto {
        let _ = write!(out, "@media(prefers-color-scheme:dark){{{}}}", colours(true));
    }
    for (name, ..) in PALETTE {
        let _ = write!(out, ".{name}{{fill:var(--{name})}}");
    }
    let _ = write!(
        out,
        "text{{font:{SIZE}px Arimo,Arial,Helvetica,'Liberation Sans',sans-serif}}.bold{{font-weight:bold}}\
         .frame{{stroke:var(--line);stroke-width:1.2}}.dashed{{stroke-dasharray:5 4}}\
         .arrow{{fill:none;stroke:var(--line);stroke-width:1.4}}"
    );
    out
}

fn name(ink: Ink) -> &'static str {
    PALETTE[ink as usize].0
}

fn shape(shape: &DrawnShape, out: &mut String) {
    // Writing into a `String` cannot fail.
    let _ = match shape {
        DrawnShape::Frame { at, radius, fill, dashed, state } => writeln!(
            out,
            "<rect class=\"{} frame{}\"{} x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"{radius:.1}\"/>",
            name(*fill),
            if *dashed { " dashed" } else { "" },
            state.as_ref().map_or_else(String::new, |path| format!(" data-state=\"{}\"", escape(path))),
            at.x,
            at.y,
            at.size.width,
            at.size.height
        ),
        DrawnShape::Line(steps) => {
            out.push_str("<path class=\"arrow\" d=\"");
            for step in steps {
                let _ = match step {
                    LineStep::Move((x, y)) => write!(out, "M{x:.1} {y:.1}"),
                    LineStep::Line((x, y)) => write!(out, "L{x:.1} {y:.1}"),
                    LineStep::Curve(a, b, p) => {
                        write!(out, "C{:.1} {:.1} {:.1} {:.1} {:.1} {:.1}", a.0, a.1, b.0, b.1, p.0, p.1)
                    }
                };
            }
            writeln!(out, "\"/>")
        }
        DrawnShape::Head([a, b, c]) => writeln!(
            out,
            "<path class=\"line\" d=\"M{:.1} {:.1}L{:.1} {:.1}L{:.1} {:.1}z\"/>",
            a.0, a.1, b.0, b.1, c.0, c.1
        ),
        DrawnShape::Dot((x, y), radius) => {
            writeln!(out, "<circle class=\"line\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\"/>")
        }
        // The length keeps texts apart where another font is wider.
        DrawnShape::Text { at: (x, y), text, ink, weight } => writeln!(
            out,
            "<text class=\"{}{}\" x=\"{x:.1}\" y=\"{y:.1}\" textLength=\"{:.1}\" \
             lengthAdjust=\"spacingAndGlyphs\">{}</text>",
            name(*ink),
            if *weight == Weight::Bold { " bold" } else { "" },
            width(text, *weight),
            escape(text)
        ),
    };
}
