//! A picture as PNG.

use std::io::Cursor;

use image::{ImageError, ImageFormat, RgbaImage};
use tiny_skia::{Color, FillRule, Paint, Path, PathBuilder, Pixmap, Stroke, StrokeDash, Transform};
use ttf_parser::OutlineBuilder;

use super::font::{SIZE, Weight, advance, face};
use super::geometry::{LineStep, Point, Rect};
use super::scene::{ChartPicture, DrawnShape, Ink, PALETTE};
use super::{DrawError, Theme};

/// Pixels of the image for one of the picture: fine enough for screens of high resolution.
const SCALE: f32 = 2.0;
/// Most pixels of an image; a larger picture gets fewer for each of its own.
const MAX_PIXELS: f32 = 64e6;
/// Least scale at which texts can be read.
const MIN_SCALE: f32 = 0.9;
/// Distance of a Bézier curve's control points from the ends of a quarter of a circle, relative to its radius.
const QUARTER: f64 = 0.5523;

/// Writes a picture as PNG; [`Theme::Auto`] is light. Refused when the texts of an image of 64 million pixels would be too small.
pub(super) fn png(scene: &ChartPicture, theme: Theme) -> Result<Vec<u8>, DrawError> {
    let (width, height) = (scene.size.width.ceil() as f32, scene.size.height.ceil() as f32);
    let too_large = DrawError::TooLarge { width: width.into(), height: height.into() };
    let scale = SCALE.min((MAX_PIXELS / (width * height)).sqrt());
    let pixels = |length: f32| (length * scale) as u32;
    let pixmap = if scale < MIN_SCALE { None } else { Pixmap::new(pixels(width), pixels(height)) };
    let Some(pixmap) = pixmap else { return Err(too_large) };
    let mut canvas =
        Canvas { pixmap, dark: theme == Theme::Dark, scale: Transform::from_scale(scale, scale) };
    canvas.pixmap.fill(canvas.color(Ink::Paper));
    scene.shapes.iter().for_each(|shape| canvas.draw(shape));
    let (width, height) = (canvas.pixmap.width(), canvas.pixmap.height());
    let image = RgbaImage::from_raw(width, height, canvas.pixmap.take_demultiplied());
    let image = image::DynamicImage::from(image.expect("a pixel has four bytes")).into_rgb8();
    let mut file = Cursor::new(Vec::new());
    image.write_to(&mut file, ImageFormat::Png).map_err(|source: ImageError| DrawError::Png { source })?;
    Ok(file.into_inner())
}

struct Canvas {
    pixmap: Pixmap,
    dark: bool,
    scale: Transform,
}

impl Canvas {
    fn color(&self, ink: Ink) -> Color {
        let (_, light, dark) = PALETTE[ink as usize];
        let [_, r, g, b] = (if self.dark { dark } else { light }).to_be_bytes();
        Color::from_rgba8(r, g, b, 255)
    }

    fn paint(&self, ink: Ink) -> Paint<'static> {
        let mut paint = Paint { anti_alias: true, ..Paint::default() };
        paint.set_color(self.color(ink));
        paint
    }

    fn fill(&mut self, path: Option<Path>, ink: Ink) {
        // A path without an area is not drawn.
        if let Some(path) = path {
            let paint = self.paint(ink);
            self.pixmap.fill_path(&path, &paint, FillRule::Winding, self.scale, None);
        }
    }

    fn stroke(&mut self, path: Option<Path>, width: f32, dashed: bool) {
        if let Some(path) = path {
            let dash = if dashed { StrokeDash::new(vec![5.0, 4.0], 0.0) } else { None };
            let stroke = Stroke { width, dash, ..Stroke::default() };
            let paint = self.paint(Ink::Line);
            self.pixmap.stroke_path(&path, &paint, &stroke, self.scale, None);
        }
    }

    fn draw(&mut self, shape: &DrawnShape) {
        match shape {
            DrawnShape::Frame { at, radius, fill, dashed, .. } => {
                let path = path(&round(at, *radius));
                self.fill(path.clone(), *fill);
                self.stroke(path, 1.2, *dashed);
            }
            DrawnShape::Line(steps) => self.stroke(path(steps), 1.4, false),
            DrawnShape::Head([a, b, c]) => {
                self.fill(path(&[LineStep::Move(*a), LineStep::Line(*b), LineStep::Line(*c)]), Ink::Line);
            }
            DrawnShape::Dot((x, y), radius) => {
                self.fill(PathBuilder::from_circle(*x as f32, *y as f32, *radius as f32), Ink::Line);
            }
            DrawnShape::Text { at, text, ink, weight } => self.fill(glyphs(*at, text, *weight), *ink),
        }
    }
}

fn path(steps: &[LineStep]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for step in steps {
        let at = |p: &Point| (p.0 as f32, p.1 as f32);
        match step {
            LineStep::Move(p) => builder.move_to(at(p).0, at(p).1),
            LineStep::Line(p) => builder.line_to(at(p).0, at(p).1),
            LineStep::Curve(a, b, p) => {
                let (a, b, p) = (at(a), at(b), at(p));
                builder.cubic_to(a.0, a.1, b.0, b.1, p.0, p.1);
            }
        }
    }
    builder.finish()
}

/// The outline of a rectangle with round corners.
fn round(at: &Rect, radius: f64) -> Vec<LineStep> {
    let radius = radius.min(at.size.width / 2.0).min(at.size.height / 2.0);
    let corners = [(at.x, at.y), (at.right(), at.y), (at.right(), at.bottom()), (at.x, at.bottom())];
    // The direction in which each corner is left.
    let ways = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)];
    let along = |p: Point, way: Point, by: f64| (p.0 + way.0 * by, p.1 + way.1 * by);
    let mut steps = vec![LineStep::Move(along(corners[0], ways[0], radius))];
    for n in 1..=4 {
        let (corner, arrives, leaves) = (corners[n % 4], ways[n - 1], ways[n % 4]);
        let rest = radius * (1.0 - QUARTER);
        steps.push(LineStep::Line(along(corner, arrives, -radius)));
        let control = (along(corner, arrives, -rest), along(corner, leaves, rest));
        steps.push(LineStep::Curve(control.0, control.1, along(corner, leaves, radius)));
    }
    steps
}

/// The outlines of a line of text.
fn glyphs(at: Point, text: &str, weight: Weight) -> Option<Path> {
    let face = face(weight);
    let scale = SIZE / f64::from(face.units_per_em());
    let mut pen = Pen { path: PathBuilder::new(), at, scale };
    for c in text.chars() {
        // A character that the font lacks has the font's empty box.
        face.outline_glyph(face.glyph_index(c).unwrap_or_default(), &mut pen);
        pen.at.0 += advance(c, weight) * SIZE;
    }
    pen.path.finish()
}

/// Draws glyphs at a place.
struct Pen {
    path: PathBuilder,
    at: Point,
    scale: f64,
}

impl Pen {
    fn place(&self, x: f32, y: f32) -> (f32, f32) {
        let place = (self.at.0 + f64::from(x) * self.scale, self.at.1 - f64::from(y) * self.scale);
        (place.0 as f32, place.1 as f32)
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place(x, y);
        self.path.move_to(x, y);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        let (x, y) = self.place(x, y);
        self.path.line_to(x, y);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ((x1, y1), (x, y)) = (self.place(x1, y1), self.place(x, y));
        self.path.quad_to(x1, y1, x, y);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ((x1, y1), (x2, y2), (x, y)) = (self.place(x1, y1), self.place(x2, y2), self.place(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }

    fn close(&mut self) {
        self.path.close();
    }
}
