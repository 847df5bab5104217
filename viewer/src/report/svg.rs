//! Writes SVG: shapes with classes. The page's style sheet sets the colours.

use std::fmt::Write as _;

use crate::markup::escape;

/// A picture in its own pixels, y downwards. Shapes with a coordinate that is not finite are omitted.
pub(super) struct Svg {
    width: f64,
    height: f64,
    title: String,
    body: String,
}

/// The alignment of a text relative to its point.
#[derive(Clone, Copy)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

fn drawable<const N: usize>(coordinates: [f64; N]) -> bool {
    coordinates.iter().all(|c| c.abs() < 1e7)
}

/// Approximate width of a text in the page's plots, px, to keep texts apart.
pub(super) fn text_width(text: &str) -> f64 {
    text.chars().map(|c| if "iljtf.,:;|' ()".contains(c) { 4.2 } else { 7.4 }).sum()
}

/// Cuts a text to a width, px, and marks the cut with an ellipsis.
pub(super) fn fit(text: &str, width: f64) -> String {
    if text_width(text) <= width {
        return text.to_owned();
    }
    let mut out = String::new();
    for c in text.chars() {
        if text_width(&out) + 15.0 > width {
            break;
        }
        out.push(c);
    }
    out.push('…');
    out
}

impl Svg {
    pub(super) fn new(width: f64, height: f64, title: &str) -> Self {
        Self { width, height, title: escape(title), body: String::new() }
    }

    fn push(&mut self, shape: std::fmt::Arguments<'_>) {
        self.body.write_fmt(shape).expect("writing to a string succeeds");
    }

    pub(super) fn line(&mut self, from: [f64; 2], to: [f64; 2], class: &str) {
        let ([x1, y1], [x2, y2]) = (from, to);
        if !drawable([x1, y1, x2, y2]) {
            return;
        }
        self.push(format_args!(
            r#"<line x1="{x1:.1}" y1="{y1:.1}" x2="{x2:.1}" y2="{y2:.1}" class="{class}"/>"#
        ));
    }

    pub(super) fn rect(&mut self, at: [f64; 2], size: [f64; 2], class: &str, tip: &str) {
        let ([x, y], [w, h]) = (at, size);
        if !drawable([x, y, w, h]) {
            return;
        }
        self.push(format_args!(
            r#"<rect x="{x:.1}" y="{y:.1}" width="{:.1}" height="{:.1}" class="{class}">"#,
            w.max(0.0),
            h.max(0.0)
        ));
        if !tip.is_empty() {
            self.push(format_args!("<title>{}</title>", escape(tip)));
        }
        self.body.push_str("</rect>");
    }

    pub(super) fn circle(&mut self, at: [f64; 2], radius: f64, class: &str) {
        if !drawable(at) {
            return;
        }
        self.push(format_args!(
            r#"<circle cx="{:.1}" cy="{:.1}" r="{radius:.1}" class="{class}"/>"#,
            at[0], at[1]
        ));
    }

    pub(super) fn text(&mut self, at: [f64; 2], anchor: Anchor, class: &str, text: &str) {
        if !drawable(at) {
            return;
        }
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        self.push(format_args!(
            r#"<text x="{:.1}" y="{:.1}" text-anchor="{anchor}" class="{class}">{}</text>"#,
            at[0],
            at[1],
            escape(text)
        ));
    }

    pub(super) fn polyline(&mut self, points: impl IntoIterator<Item = [f64; 2]>, class: &str) {
        self.push(format_args!(r#"<polyline class="{class}" points=""#));
        for [x, y] in points.into_iter().filter(|point| drawable(*point)) {
            self.push(format_args!("{x:.1},{y:.1} "));
        }
        self.body.push_str(r#""/>"#);
    }

    /// An image as a data URI; pixels stay sharp when scaled.
    pub(super) fn image(&mut self, at: [f64; 2], size: [f64; 2], uri: &str) {
        let ([x, y], [w, h]) = (at, size);
        self.push(format_args!(
            r#"<image x="{x:.1}" y="{y:.1}" width="{w:.1}" height="{h:.1}" preserveAspectRatio="none" style="image-rendering:pixelated" href="{uri}"/>"#
        ));
    }

    /// Clips drawing to a rectangle; coordinates stay the same.
    pub(super) fn clipped(&mut self, at: [f64; 2], size: [f64; 2], draw: impl FnOnce(&mut Self)) {
        let ([x, y], [w, h]) = (at, size);
        self.push(format_args!(
            r#"<svg x="{x:.1}" y="{y:.1}" width="{w:.1}" height="{h:.1}" viewBox="{x:.1} {y:.1} {w:.1} {h:.1}">"#
        ));
        draw(self);
        self.body.push_str("</svg>");
    }

    pub(super) fn finish(self, class: &str) -> String {
        let Self { width, height, title, body } = self;
        format!(
            r#"<svg class="plot {class}" viewBox="0 0 {width:.0} {height:.0}" role="img" aria-label="{title}" xmlns="http://www.w3.org/2000/svg">{body}</svg>"#
        )
    }
}

/// A data URI of bytes.
pub(super) fn data_uri(media_type: &str, data: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = format!("data:{};base64,", escape(media_type));
    out.reserve(data.len() / 3 * 4 + 4);
    for chunk in data.chunks(3) {
        let word =
            chunk.iter().enumerate().fold(0_u32, |word, (i, byte)| word | u32::from(*byte) << (16 - 8 * i));
        for i in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * i)) as usize & 63];
            out.push(if i <= chunk.len() { char::from(digit) } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_agrees_with_the_examples_of_rfc_4648() {
        for (text, code) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(data_uri("a/b", text.as_bytes()), format!("data:a/b;base64,{code}"));
        }
    }

    #[test]
    fn text_from_outside_cannot_open_a_tag() {
        assert_eq!(escape("<b a='\"&\u{1}"), "&lt;b a=&#39;&quot;&amp;\u{fffd}");
    }

    #[test]
    fn a_long_text_is_cut_to_its_width() {
        let cut = fit("a very long name of a state", 80.0);
        assert!(cut.ends_with('…') && text_width(&cut) <= 82.0, "{cut}");
        assert_eq!(fit("short", 80.0), "short");
    }
}
