//! Balls, cylinders and capsules: each pixel's ray is intersected with the surface exactly.

use nalgebra::{Isometry3, Vector3};

use super::faces::Face;
use super::raster::{Bounds, Canvas, ColumnRange, Lanes, ScanLine};
use super::scene::VisibleForm;
use super::shading::{Light, Shades, brightness};

/// A ray does not meet a cylinder's side if its direction across the axis is shorter than this (squared).
const PARALLEL: f32 = 1e-12;

/// The square around a cylinder's end by the end, so that rounding cuts nothing off.
const WIDER: f64 = 1.001;

/// How far a capsule's ends reach under its side, in radii, so that there is no visible gap.
const OVERLAP: f32 = 0.01;

/// Draws a ball with its centre in the camera frame.
pub(super) fn ball(canvas: &mut Canvas, center: &Vector3<f64>, radius: f64, light: Light, shades: &Shades) {
    half_ball(canvas, (center, &Vector3::zeros()), radius, light, shades);
}

/// Draws the half of a ball on the side of `outward` (unit vector, camera frame); all of it for zero.
fn half_ball(
    canvas: &mut Canvas,
    (center, outward): (&Vector3<f64>, &Vector3<f64>),
    radius: f64,
    light: Light,
    shades: &Shades,
) {
    let Some(bounds) = canvas.ball(center, radius) else { return };
    let power = center.norm_squared() - radius * radius;
    if power <= 0.0 {
        return;
    }
    for row in canvas.rows(bounds) {
        ball_row(canvas, row, bounds, &Ball { center, outward, radius, power, light, shades });
    }
}

struct Ball<'a> {
    center: &'a Vector3<f64>,
    outward: &'a Vector3<f64>,
    radius: f64,
    /// Squared distance of the centre less the squared radius.
    power: f64,
    light: Light,
    shades: &'a Shades,
}

/// One row of a ball.
///
/// With the ray d and the centre c, the discriminant (d.c)^2 - |d|^2 power is `a x^2 + 2 b x + c` in the ray's x.
/// It is written about its vertex, where single precision suffices.
fn ball_row(canvas: &mut Canvas, row: ScanLine, bounds: Bounds, ball: &Ball<'_>) {
    let Ball { center, outward, radius, power, light, shades } = *ball;
    let along = row.y * center.y + center.z;
    let rest = row.y * row.y + 1.0;
    let (a, b, c) = (center.x * center.x - power, center.x * along, along * along - rest * power);
    let mut span = bounds.columns();
    let (origin, linear, constant) = if a < 0.0 { (-b / a, 0.0, c - b * b / a) } else { (0.0, 2.0 * b, c) };
    if a < 0.0 {
        if constant < 0.0 {
            return;
        }
        let half = (constant / -a).sqrt();
        span = span.and(ColumnRange::new(row.column(origin - half), row.column(origin + half)));
    }
    let Some(run) = span.pixels() else { return };
    let x = row.x().line(run.0);
    let [toward, lit, out] = [center, &light.toward, outward].map(|n| row.form(n).line(run.0));
    let (a, linear, constant, origin) = (a as f32, linear as f32, constant as f32, origin as f32);
    let (rest, center_lit) = (rest as f32, center.dot(&light.toward) as f32);
    let inverse_radius = (1.0 / radius) as f32;
    let border = center.dot(outward) as f32 - OVERLAP * radius as f32;
    canvas.fill(
        row.v,
        run,
        |k| {
            let x = x.at(k);
            let offset = x - origin;
            // Negative where the ray misses; the root is then NaN, and nothing is drawn.
            let discriminant = (offset * a + linear) * offset + constant;
            let squared = x * x + rest;
            let reach = toward.at(k) - discriminant.sqrt();
            let t = reach / squared;
            let near = (t * out.at(k)).simd_ge(border) & (squared / reach);
            (near, (t * lit.at(k) - center_lit) * inverse_radius)
        },
        |_, _, cosine| shades.lanes(brightness(cosine)),
    );
}

/// A body with an axis, and the camera in its frame.
pub(super) struct Axial {
    /// Radius, m.
    pub(super) radius: f64,
    /// Half the length along z, m.
    pub(super) half_length: f64,
    /// Its pose.
    pub(super) camera_from_shape: Isometry3<f64>,
}

/// Draws a flat-ended cylinder.
pub(super) fn cylinder(canvas: &mut Canvas, body: &Axial, light: Light, shades: &Shades) {
    side(canvas, body, light, shades);
    cap(canvas, body, 1.0, light, shades);
    cap(canvas, body, -1.0, light, shades);
}

/// Draws a round-ended cylinder.
pub(super) fn capsule(canvas: &mut Canvas, body: &Axial, light: Light, shades: &Shades) {
    side(canvas, body, light, shades);
    let axis = body.camera_from_shape.rotation * Vector3::z();
    for sign in [-1.0, 1.0] {
        half_ball(canvas, (&body.end(sign), &(axis * sign)), body.radius, light, shades);
    }
}

impl Axial {
    /// The middle of an end (sign -1 or 1) in the camera frame.
    fn end(&self, sign: f64) -> Vector3<f64> {
        let axis = self.camera_from_shape.rotation * Vector3::z();
        self.camera_from_shape.translation.vector + axis * (sign * self.half_length)
    }

    /// The camera's position in the shape's frame.
    fn eye(&self) -> Vector3<f64> {
        -(self.camera_from_shape.rotation.inverse() * self.camera_from_shape.translation.vector)
    }

    /// The shape's axes in the camera frame.
    fn axes(&self) -> [Vector3<f64>; 3] {
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| self.camera_from_shape.rotation * axis)
    }

    /// The rectangle in which the balls about both ends can appear.
    fn bounds(&self, canvas: &Canvas) -> Option<Bounds> {
        let ends = [-1.0, 1.0].map(|sign| self.end(sign));
        if ends.iter().any(|end| end.z < self.radius) && ends.iter().any(|end| end.z > -self.radius) {
            return canvas.bounds();
        }
        match ends.map(|end| canvas.ball(&end, self.radius)) {
            [Some(a), Some(b)] => Some(a.union(b)),
            _ => self.partial(canvas),
        }
    }

    /// For a body with one end outside the picture: the bounds of the box around it.
    fn partial(&self, canvas: &Canvas) -> Option<Bounds> {
        let around = VisibleForm::Capsule { radius: self.radius, half_length: self.half_length };
        canvas.hull(&around.corners().map(|corner| self.camera_from_shape * corner))
    }
}

/// Draws the side of a cylinder: where the ray enters the infinite cylinder, between its ends.
fn side(canvas: &mut Canvas, body: &Axial, light: Light, shades: &Shades) {
    let eye = body.eye();
    let distance = eye.xy().norm();
    if distance <= body.radius {
        return;
    }
    let Some(bounds) = body.bounds(canvas) else { return };
    let [ax, ay, az] = body.axes();
    // The rays that meet the infinite cylinder in front of the camera lie between its two tangent planes.
    let inward = -(ax * eye.x + ay * eye.y) / distance;
    let across = (ax * eye.y - ay * eye.x) / distance;
    let (sine, cosine) = (body.radius / distance, (1.0 - (body.radius / distance).powi(2)).sqrt());
    let tangents = [across * cosine + inward * sine, inward * sine - across * cosine];
    let toward_eye = ax * eye.x + ay * eye.y;
    let cross = ay * eye.x - ax * eye.y;
    let lit = [light.toward.dot(&ax), light.toward.dot(&ay)];
    let lit_axis = ax * lit[0] + ay * lit[1];
    let eye_lit = (eye.x * lit[0] + eye.y * lit[1]) as f32;
    let (eye_z, half_length) = (eye.z as f32, body.half_length as f32);
    let (squared_radius, inverse_radius) = ((body.radius * body.radius) as f32, (1.0 / body.radius) as f32);
    for row in canvas.rows(bounds) {
        let span = tangents.iter().fold(bounds.columns(), |span, n| span.keep(row.form(n)));
        let Some(run) = span.pixels() else { continue };
        let [dx, dy, dz] = [ax, ay, az].map(|axis| row.form(&axis).line(run.0));
        let [b, w, lit] = [toward_eye, cross, lit_axis].map(|n| row.form(&n).line(run.0));
        canvas.fill(
            row.v,
            run,
            |k| {
                let (x, y) = (dx.at(k), dy.at(k));
                let a = x * x + y * y;
                let w = w.at(k);
                let root = (a * squared_radius - w * w).fast_max(Lanes::ZERO).sqrt();
                let reach = -b.at(k) - root;
                let t = reach / a;
                let z = t * dz.at(k) + eye_z;
                let hit = z.abs().simd_le(half_length) & a.simd_gt(PARALLEL);
                (hit & (a / reach), (t * lit.at(k) + eye_lit) * inverse_radius)
            },
            |_, _, cosine| shades.lanes(brightness(cosine)),
        );
    }
}

/// Draws the flat end of a cylinder on the side of `sign`, if it faces the camera.
fn cap(canvas: &mut Canvas, body: &Axial, sign: f64, light: Light, shades: &Shades) {
    let eye = body.eye();
    let height = eye.z * sign - body.half_length;
    if height <= 0.0 {
        return;
    }
    // The square around it, a little larger: of one that is seen from the side, few pixels are left.
    let half = Vector3::new(WIDER * body.radius, WIDER * body.radius, body.half_length);
    let Some(square) = Face::of_box(&body.camera_from_shape, &half, (2, sign), 1.0) else { return };
    let Some(bounds) = square.bounds(canvas) else { return };
    let edges = square.edges();
    let [ax, ay, az] = body.axes();
    let color = shades.at(light.on(&(az * sign)));
    let nearness = az * (-sign / height);
    let squared_radius = (body.radius * body.radius) as f32;
    let (eye_x, eye_y) = (eye.x as f32, eye.y as f32);
    for row in canvas.rows(bounds) {
        let span = edges.iter().fold(bounds.columns(), |span, edge| span.keep(row.form(edge)));
        let Some(run) = span.pixels() else { continue };
        let [near, dx, dy] = [nearness, ax, ay].map(|n| row.form(&n).line(run.0));
        canvas.fill(
            row.v,
            run,
            |k| {
                let near = near.at(k);
                let t = Lanes::ONE / near;
                let (x, y) = (t * dx.at(k) + eye_x, t * dy.at(k) + eye_y);
                ((x * x + y * y).simd_le(squared_radius) & near, Lanes::ZERO)
            },
            |_, _, _| [color; _],
        );
    }
}
