//! The renderer against the camera model, closed forms and a plain ray caster in double precision.

use std::sync::Arc;

use armarium_robot::Mesh;
use armarium_visionx::PinholeCamera;
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const CAMERA: PinholeCamera = PinholeCamera { width: 320, height: 240, focal: 257.5, center: [159.5, 119.5] };
const RED: [u8; 3] = [200, 60, 40];
const GREEN: [u8; 3] = [40, 190, 60];

/// A camera at the origin that looks along the scene's y with z up.
fn ahead() -> Viewpoint {
    Viewpoint::look_at(CAMERA, Vector3::zeros(), Vector3::y())
}

fn shape(geometry: VisibleForm, scene_from_shape: Isometry3<f64>, color: [u8; 3]) -> Shape {
    Shape { geometry, scene_from_shape, color }
}

fn ball(center: [f64; 3], radius: f64, color: [u8; 3]) -> Shape {
    shape(
        VisibleForm::Sphere { radius },
        Isometry3::from_parts(center.into(), UnitQuaternion::identity()),
        color,
    )
}

/// A scene in a room so large that shapes can be recognised by their depth.
fn scene(shapes: Vec<Shape>) -> VisibleScene {
    let mut scene = VisibleScene::new(shapes);
    scene.background.lower = Vector3::repeat(-50.0);
    scene.background.upper = Vector3::repeat(50.0);
    scene
}

/// Mean of the pixels that are nearer than 20 m.
fn centroid(rendering: &Rendering) -> Point2<f64> {
    let near = rendering.depth.data.iter().enumerate().filter(|(_, z)| **z < 20.0);
    let width = rendering.depth.width as usize;
    let (sum, n) = near.fold((nalgebra::Vector2::zeros(), 0), |(sum, n), (i, _)| {
        (sum + nalgebra::Vector2::new((i % width) as f64, (i / width) as f64), n + 1)
    });
    assert!(n > 0, "nothing was drawn");
    Point2::from(sum / f64::from(n))
}

fn depth_at(rendering: &Rendering, u: usize, v: usize) -> f64 {
    f64::from(rendering.depth.data[v * rendering.depth.width as usize + u])
}

#[test]
fn a_ball_appears_where_the_camera_projects_it() {
    let viewpoint = Viewpoint::look_at(CAMERA, Vector3::new(0.3, -0.2, 1.6), Vector3::new(0.1, 0.6, 0.9));
    for (i, radius) in [0.02, 0.03, 0.05].into_iter().enumerate() {
        for [u, v] in [[160.0, 120.0], [60.3, 50.7], [250.0, 190.5], [40.2, 200.0]] {
            let z = 0.8 + 0.3 * i as f64;
            let [x, y] =
                [(u - CAMERA.center[0]) * z / CAMERA.focal, (v - CAMERA.center[1]) * z / CAMERA.focal];
            let center = viewpoint.scene_from_camera * Point3::new(x, y, z);
            let seen = render(&scene(vec![ball(center.coords.into(), radius, RED)]), &viewpoint);
            let expected = CAMERA.project(&Point3::new(x, y, z)).unwrap();
            assert!((centroid(&seen) - expected).norm() < 0.5, "{:?} for {expected:?}", centroid(&seen));
            let nearest = seen.depth.data.iter().copied().fold(f32::INFINITY, f32::min);
            let closest = z - radius * z / Vector3::new(x, y, z).norm();
            assert!((f64::from(nearest) - closest).abs() < 0.15 * radius, "{nearest} for {closest}");
        }
    }
}

#[test]
fn disparity_is_focal_length_times_baseline_over_depth() {
    let baseline = 0.093;
    for z in [0.6, 0.9, 1.4] {
        let left = ahead();
        let scene = scene(vec![ball([0.05, z, 0.02], 0.03, RED)]);
        let [a, b] = [left, left.shifted_right(baseline)].map(|eye| render(&scene, &eye));
        let (a, b) = (centroid(&a), centroid(&b));
        let expected = CAMERA.focal * baseline / z;
        // Whole pixels disturb a centroid by about 0.3 px over the root of the number of rows: 0.06 px here.
        assert!((a.x - b.x - expected).abs() < 0.2, "{} for {expected}", a.x - b.x);
        assert!((a.y - b.y).abs() < 0.1, "rows of parallel cameras agree");
    }
}

#[test]
fn the_depth_of_a_tilted_plane_is_its_closed_form() {
    let tilt = UnitQuaternion::from_euler_angles(0.4, -0.2, 0.3);
    let pose = Isometry3::from_parts(Translation3::new(0.1, 1.5, -0.4), tilt);
    let half = Vector3::new(0.8, 0.8, 0.01);
    for geometry in
        [VisibleForm::Box { half }, VisibleForm::Tabletop { half, bumps: Arc::from([]), dirt: None }]
    {
        let viewpoint = ahead();
        let seen = render(&scene(vec![shape(geometry, pose, RED)]), &viewpoint);
        let (normal, mut compared) = (pose.rotation * Vector3::z(), 0);
        let foot = pose * Point3::new(0.0, 0.0, half.z);
        for v in 0..240 {
            for u in 0..320 {
                let ray = ray(&viewpoint, u, v);
                let t = foot.coords.dot(&normal) / ray.dot(&normal);
                let at = pose.inverse() * Point3::from(ray * t);
                if t > 0.0 && at.x.abs() < 0.799 && at.y.abs() < 0.799 {
                    compared += 1;
                    assert!((depth_at(&seen, u, v) - t).abs() < 1e-5, "({u}, {v})");
                }
            }
        }
        assert!(compared > 10_000);
    }
}

#[test]
fn the_nearest_shape_is_seen_whatever_the_order() {
    let (near, far) = (ball([0.0, 1.0, 0.0], 0.1, RED), ball([0.0, 1.3, 0.0], 0.25, GREEN));
    let a = render(&scene(vec![near.clone(), far.clone()]), &ahead());
    let b = render(&scene(vec![far, near]), &ahead());
    assert_eq!(a, b);
    let [r, g, _] = a.image.pixel(160, 120);
    assert!(r > g);
    let [r, g, _] = a.image.pixel(195, 120);
    assert!(g > r, "the far ball shows beside the near one");
}

#[test]
fn light_keeps_the_hue() {
    let seen = render(&scene(vec![ball([0.0, 1.0, 0.0], 0.3, RED)]), &ahead());
    let mut darkest: u8 = 255;
    for (i, z) in seen.depth.data.iter().enumerate().filter(|(_, z)| **z < 20.0) {
        let [r, g, b] = seen.image.pixel((i % 320) as u32, (i / 320) as u32);
        assert!(
            (f64::from(g) - f64::from(r) * 0.3).abs() < 1.2
                && (f64::from(b) - f64::from(r) * 0.2).abs() < 1.2
        );
        assert!(*z > 0.0);
        darkest = darkest.min(r);
    }
    assert!((85..140).contains(&darkest), "shade is mild: {darkest}");
}

#[test]
fn nothing_is_seen_of_what_is_behind_or_about_the_camera() {
    let empty = render(&scene(vec![]), &ahead());
    let forms = [
        VisibleForm::Sphere { radius: 0.3 },
        VisibleForm::Box { half: Vector3::repeat(0.3) },
        VisibleForm::Capsule { radius: 0.2, half_length: 0.1 },
        VisibleForm::Cylinder { radius: 0.2, half_length: 0.2 },
        VisibleForm::Tabletop { half: Vector3::repeat(0.3), bumps: Arc::from([]), dirt: None },
    ];
    for form in forms {
        for y in [-1.0, 0.0] {
            let seen = render(
                &scene(vec![shape(form.clone(), Isometry3::translation(0.0, y, 0.05), RED)]),
                &ahead(),
            );
            assert_eq!(seen.depth, empty.depth, "{form:?} at {y}");
        }
    }
}

#[test]
fn the_same_scene_gives_the_same_bytes_on_one_thread_or_two() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let scene = scene((0..20).map(|_| arbitrary_shape(&mut random)).collect());
    let eyes = [ahead(), ahead().shifted_right(0.09)];
    let shadowed = ShadowedScene::new(scene.clone());
    let pair = eyes.map(|eye| shadowed.render(&eye));
    assert_eq!(pair, eyes.map(|eye| shadowed.render(&eye)));
    assert_eq!(pair, eyes.map(|eye| render(&scene, &eye)));
}

#[test]
fn degenerate_input_draws_something_or_nothing_but_never_panics() {
    let numbers = [0.0, -1.0, 1e-320, 1e-9, 1.0, 1e9, 1e200, f64::MAX, f64::INFINITY, f64::NAN];
    let mut shapes = Vec::new();
    for (a, b) in numbers.into_iter().flat_map(|a| numbers.map(|b| (a, b))) {
        let bumps = Arc::from([Bump { at: [a, b], height: b, radius: a }]);
        let dirt = Arc::new(DirtTexture { columns: 3, rows: usize::MAX, cells: vec![9; 2], color: RED });
        for form in [
            VisibleForm::Sphere { radius: a },
            VisibleForm::Box { half: Vector3::new(a, b, 1.0) },
            VisibleForm::Capsule { radius: a, half_length: b },
            VisibleForm::Cylinder { radius: a, half_length: b },
            VisibleForm::Tabletop { half: Vector3::new(b, 1.0, a), bumps, dirt: Some(dirt) },
        ] {
            shapes.push(shape(form.clone(), Isometry3::translation(0.0, 1.0, 0.0), RED));
            shapes.push(shape(form, Isometry3::translation(a, b, -1.0), GREEN));
        }
    }
    let small = PinholeCamera { width: 24, height: 17, focal: 20.0, center: [12.0, 8.0] };
    for light in [Vector3::zeros(), Vector3::repeat(f64::NAN), Vector3::new(1e200, 0.0, 1e200)] {
        let mut scene = scene(shapes.clone());
        scene.light = light;
        let _ = render(&scene, &Viewpoint { camera: small, ..ahead() });
    }
    for n in numbers {
        let camera = PinholeCamera { focal: n, center: [n, 8.0], ..small };
        let _ = render(&scene(shapes[..40].to_vec()), &Viewpoint { camera, ..ahead() });
        let eye = Vector3::new(n, 0.0, n);
        let _ = render(&scene(shapes[..40].to_vec()), &Viewpoint::look_at(small, eye, Vector3::zeros()));
        let mut scene = scene(vec![]);
        scene.background.upper = Vector3::new(1.0, n, 1.0);
        let _ = render(&scene, &Viewpoint { camera: small, ..ahead() });
    }
    for (width, height) in [(0, 9), (u32::MAX, u32::MAX)] {
        let camera = PinholeCamera { width, height, ..small };
        assert!(render(&scene(vec![]), &Viewpoint { camera, ..ahead() }).image.data().is_empty());
    }
}

#[test]
fn a_bump_rises_by_its_height_and_dirt_and_shadow_darken() {
    let half = Vector3::new(0.4, 0.4, 0.01);
    let bumps = Arc::from([Bump { at: [0.1, 0.05], height: 0.005, radius: 0.06 }]);
    let mut dirt = DirtTexture::clean(80, 80, [20, 20, 20]);
    dirt.cells[20 * 80 + 20] = 255;
    let table = VisibleForm::Tabletop { half, bumps, dirt: Some(Arc::new(dirt)) };
    let camera = PinholeCamera { width: 321, height: 241, focal: 257.5, center: [160.0, 120.0] };
    let above =
        |x: f64, y: f64| Viewpoint::look_at(camera, Vector3::new(x, y, 1.01), Vector3::new(x, y, 0.0));
    let table = shape(table, Isometry3::identity(), [150, 115, 80]);
    let bare = scene(vec![table.clone()]);
    let bumped = render(&bare, &above(0.1, 0.05));
    assert!((depth_at(&bumped, 160, 120) - 0.995).abs() < 1e-6);
    let slope_point = depth_at(&bumped, 160 + 10, 120);
    let x = 10.0 / 257.5;
    let expected = 1.0 - Bump { at: [0.0, 0.0], height: 0.005, radius: 0.06 }.height_at(x * slope_point, 0.0);
    assert!((slope_point - expected).abs() < 1e-6, "{slope_point} for {expected}");
    let dirty = render(&bare, &above(-0.1975 + 0.0, -0.1975)).image;
    assert!(dirty.pixel(160, 120)[0] < 40, "{:?}", dirty.pixel(160, 120));
    assert!(dirty.pixel(160 + 8, 120)[0] > 100);
    // A ball that lies on the table; the light comes from the right.
    let mut shaded = scene(vec![table, ball([-0.2, 0.2, 0.04], 0.03, RED)]);
    shaded.light = Vector3::new(1.0, 0.0, 2.0);
    let beside = render(&shaded, &above(-0.2, 0.2)).image;
    let [under, away] = [beside.pixel(160 - 11, 120), beside.pixel(160 + 40, 120)];
    assert!(under[2] + 10 < away[2], "{under:?} {away:?}");
}

/// The ray of a pixel in the scene's frame; its component along the optical axis is 1.
fn ray(viewpoint: &Viewpoint, u: usize, v: usize) -> Vector3<f64> {
    let camera = viewpoint.camera;
    let x = (u as f64 - camera.center[0]) / camera.focal;
    let y = (v as f64 - camera.center[1]) / camera.focal;
    viewpoint.scene_from_camera.rotation * Vector3::new(x, y, 1.0)
}

fn arbitrary_shape(random: &mut ChaCha8Rng) -> Shape {
    let mut size = || random.random_range(0.01..0.25);
    let geometry = match size() {
        s if s < 0.07 => VisibleForm::Sphere { radius: size() },
        s if s < 0.13 => VisibleForm::Box { half: Vector3::new(size(), size(), size()) },
        s if s < 0.19 => VisibleForm::Cylinder { radius: size(), half_length: size() },
        _ => VisibleForm::Capsule { radius: size(), half_length: size() },
    };
    let mut number = || random.random_range(-1.0..1.0);
    let turn = UnitQuaternion::from_euler_angles(number() * 3.1, number() * 3.1, number() * 3.1);
    // Some are beside, around and behind the camera.
    let place = Translation3::new(number(), number() + 0.7, number() * 0.8);
    shape(geometry, Isometry3::from_parts(place, turn), random.random())
}

/// Depth where a ray from the origin enters a shape from outside. Computed in another way than by the renderer:
/// slabs, and quadratic equations in the shape's frame.
fn entry(shape: &Shape, ray: &Vector3<f64>) -> Option<f64> {
    let eye = shape.scene_from_shape.inverse_transform_point(&Point3::origin());
    let d = shape.scene_from_shape.inverse_transform_vector(ray);
    let sphere = |center: Vector3<f64>, radius: f64| {
        let o = eye.coords - center;
        let b = o.dot(&d);
        let root = b * b - d.norm_squared() * (o.norm_squared() - radius * radius);
        (root >= 0.0).then(|| [(-b - root.sqrt()) / d.norm_squared(), (-b + root.sqrt()) / d.norm_squared()])
    };
    let slab = |axis: usize, half: f64| {
        let [a, b] = [(-half - eye[axis]) / d[axis], (half - eye[axis]) / d[axis]];
        [a.min(b), a.max(b)]
    };
    let tube = |radius: f64| {
        let (a, b) = (d.xy().norm_squared(), eye.coords.xy().dot(&d.xy()));
        let root = b * b - a * (eye.coords.xy().norm_squared() - radius * radius);
        (root >= 0.0).then(|| [(-b - root.sqrt()) / a, (-b + root.sqrt()) / a])
    };
    let both =
        |a: [f64; 2], b: [f64; 2]| Some([a[0].max(b[0]), a[1].min(b[1])]).filter(|[low, high]| low <= high);
    let inside = match shape.geometry {
        VisibleForm::Sphere { radius } => sphere(Vector3::zeros(), radius),
        VisibleForm::Box { half } => {
            both(slab(0, half.x), slab(1, half.y)).and_then(|s| both(s, slab(2, half.z)))
        }
        VisibleForm::Cylinder { radius, half_length } => {
            tube(radius).and_then(|t| both(t, slab(2, half_length)))
        }
        VisibleForm::Capsule { radius, half_length } => {
            let ends = [-half_length, half_length].map(|z| sphere(Vector3::new(0.0, 0.0, z), radius));
            let side = tube(radius).and_then(|t| both(t, slab(2, half_length)));
            let parts = ends.into_iter().chain([side]).flatten();
            parts.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
        }
        VisibleForm::Tabletop { .. } | VisibleForm::Mesh { .. } => None,
    };
    inside.map(|[low, _]| low).filter(|t| *t > 0.0)
}

#[test]
fn agrees_with_a_plain_ray_caster() {
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let (mut covered, mut differing) = (0_u32, 0_u32);
    for _ in 0..60 {
        let scene = scene((0..8).map(|_| arbitrary_shape(&mut random)).collect());
        let viewpoint = ahead();
        let seen = render(&scene, &viewpoint);
        for (u, v) in (0..240).step_by(3).flat_map(|v| (0..320).step_by(3).map(move |u| (u, v))) {
            let ray = ray(&viewpoint, u, v);
            // The renderer leaves out what is nearer than 1 cm; this skips the rays that would meet it.
            let hits: Vec<f64> = scene.shapes.iter().filter_map(|shape| entry(shape, &ray)).collect();
            let Some(expected) = hits.into_iter().filter(|t| *t > 0.0101).reduce(f64::min) else { continue };
            covered += 1;
            let actual = depth_at(&seen, u, v);
            differing += u32::from((actual - expected).abs() > 2e-4);
        }
    }
    assert!(covered > 80_000, "{covered}");
    // Grazing rays and borders may differ in single precision.
    assert!(differing * 5_000 < covered, "{differing} of {covered}");
}

/// The surface of a cuboid as twelve triangles, with every winding.
fn cuboid_of_triangles(half: &Vector3<f64>) -> Mesh {
    let side = |i: usize, axis: usize| if i >> axis & 1 == 0 { -half[axis] } else { half[axis] };
    let corners = (0..8).map(|i| Point3::new(side(i, 0), side(i, 1), side(i, 2))).collect();
    let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let triangles = faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [d, c, a]]).collect();
    Mesh::new(corners, triangles).unwrap()
}

#[test]
fn triangles_look_like_the_cuboid_whose_surface_they_are() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut covered = 0;
    for _ in 0..40 {
        let mut any = |low: f64, high: f64| random.random_range(low..high);
        let half = Vector3::new(any(0.05, 0.3), any(0.05, 0.3), any(0.05, 0.3));
        let turn =
            UnitQuaternion::from_scaled_axis(Vector3::new(any(-2.0, 2.0), any(-2.0, 2.0), any(-2.0, 2.0)));
        let pose =
            Isometry3::from_parts(Translation3::new(any(-0.5, 0.5), any(0.8, 2.0), any(-0.4, 0.4)), turn);
        let solid = render(&scene(vec![shape(VisibleForm::Box { half }, pose, RED)]), &ahead());
        let mesh = VisibleForm::Mesh { mesh: Arc::new(cuboid_of_triangles(&half)) };
        let surface = render(&scene(vec![shape(mesh, pose, RED)]), &ahead());
        for (a, b) in solid.depth.data.iter().zip(&surface.depth.data).filter(|(a, _)| **a < 20.0) {
            covered += 1;
            // Along the border of two triangles, single precision may leave a pixel to the room behind.
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
    }
    assert!(covered > 50_000, "{covered}");
}

#[test]
fn a_mesh_around_the_camera_and_one_behind_it_are_no_trouble() {
    let mesh = Arc::new(cuboid_of_triangles(&Vector3::repeat(0.5)));
    for y in [-2.0, -0.5, 0.0, 0.45] {
        let pose = Isometry3::translation(0.0, y, 0.0);
        let seen =
            render(&scene(vec![shape(VisibleForm::Mesh { mesh: Arc::clone(&mesh) }, pose, RED)]), &ahead());
        let expected = 0.5 + y;
        let depth = depth_at(&seen, 160, 120);
        assert!(if expected > 0.01 { (depth - expected).abs() < 1e-3 } else { depth > 20.0 }, "{y}: {depth}");
    }
}

/// A bright panel before a dark one, both of which fill the picture's height, and the panel's motion during the exposure, m.
fn panels(shift: Vector3<f64>) -> VisibleScene {
    let panel = |half: f64, y: f64, color| {
        let half = Vector3::new(half, 0.01, 5.0);
        shape(VisibleForm::Box { half }, Isometry3::translation(0.0, y, 0.0), color)
    };
    let mut scene = scene(vec![panel(0.2, 1.01, RED), panel(9.0, 3.01, GREEN)]);
    scene.motions = vec![ExposureMotion { shift, turn: Vector3::zeros() }];
    scene
}

/// The share of the bright panel in each pixel of a row.
fn shares(picture: &Rendering, sharp: &Rendering, v: u32) -> Vec<f64> {
    let red = |picture: &Rendering, u: u32| f64::from(picture.image.pixel(u, v)[0]);
    let (bright, dark) = (red(sharp, 160), red(sharp, 5));
    (0..CAMERA.width).map(|u| (red(picture, u) - dark) / (bright - dark)).collect()
}

#[test]
fn what_moves_is_smeared_over_its_way_and_what_stands_is_not() {
    let viewpoint = ahead();
    let sharp = render(&panels(Vector3::zeros()), &viewpoint);
    for pixels in [3.0, 7.0, 12.0] {
        // The panel's front is 1 m away.
        let moved = render(&panels(Vector3::x() * pixels / CAMERA.focal), &viewpoint);
        assert_eq!(moved.depth, sharp.depth, "depth is that of the middle of the exposure");
        let (shares, still) = (shares(&moved, &sharp, 120), shares(&sharp, &sharp, 120));
        let edges = [-0.2, 0.2].map(|x| CAMERA.center[0] + x * CAMERA.focal);
        for (u, share) in shares.iter().enumerate() {
            // The share of the exposure in which the panel covers the pixel's centre: a ramp as long as the way.
            let ramp = |edge: f64| ((u as f64 - edge) / pixels + 0.5).clamp(0.0, 1.0);
            let expected = ramp(edges[0]) - ramp(edges[1]);
            assert!(
                (share - expected).abs() < 0.5 / pixels + 0.02,
                "{pixels} px, {u}: {share} for {expected}"
            );
        }
        let mixed = |shares: &[f64]| shares.iter().filter(|s| (0.02..0.98).contains(*s)).count() as f64;
        assert!((mixed(&shares) - 2.0 * pixels).abs() <= 2.0 && mixed(&still) == 0.0, "{}", mixed(&shares));
    }
    // Less than two pixels are not seen.
    assert_eq!(render(&panels(Vector3::x() * 1.9 / CAMERA.focal), &viewpoint), sharp);
}

#[test]
fn a_camera_that_turns_smears_everything_but_what_turns_with_it() {
    let turning = ExposureMotion { shift: Vector3::zeros(), turn: Vector3::z() * (8.0 / CAMERA.focal) };
    let viewpoint = Viewpoint { motion: turning, ..ahead() };
    let still = panels(Vector3::zeros());
    let (sharp, smeared) = (render(&still, &ahead()), render(&still, &viewpoint));
    let (left, right) = (shares(&smeared, &sharp, 120), shares(&sharp, &sharp, 120));
    let mixed = |shares: &[f64]| shares.iter().filter(|s| (0.02..0.98).contains(*s)).count();
    // Beside the optical axis, a turn moves the picture by focal (1 + (x/z)^2) a radian: 8.3 px at each edge, of which n
    // instants show all but 1/n, from the middle of the first part to that of the last.
    assert!((14..=16).contains(&mixed(&left)) && mixed(&right) == 0, "{}", mixed(&left));
    // A scene that turns about the camera as the camera does stands still in its picture, but for the room.
    let mut carried = still;
    let levers = carried.shapes.iter().map(|shape| shape.scene_from_shape.translation.vector);
    carried.motions =
        levers.map(|lever| ExposureMotion { shift: turning.turn.cross(&lever), ..turning }).collect();
    let seen = render(&carried, &viewpoint);
    assert_eq!(mixed(&shares(&seen, &sharp, 120)), 0);
}
