//! Tests of the tracker on rendered objects.

use super::*;
use crate::scenes::{CALIBRATION, TABLE, Thing, empty_frames, frame, root_from_left, table};

const GREEN: [u8; 3] = [40, 170, 60];

fn ball(center: Point3<f64>, radius: f64, color: [u8; 3]) -> Thing {
    Thing::Ball { center, radius, color }
}

/// A tool on a circle, half a turn per second.
fn path(i: u64) -> Point3<f64> {
    let angle = std::f64::consts::PI * i as f64 / 15.0;
    Point3::new(0.28 + 0.06 * libm::sin(angle), 0.53 + 0.05 * libm::cos(angle), 1.05)
}

fn stamp(i: u64) -> u64 {
    i * 66_666_667
}

fn tracker() -> ColorMarkerObjectTracking {
    ColorMarkerObjectTracking::new(CALIBRATION, GREEN, None, 1)
}

fn error(estimate: &MarkerEstimate, truth: &Point3<f64>) -> Vector3<f64> {
    estimate.point_in_left - root_from_left().inverse() * truth
}

#[test]
fn follows_a_tool_past_a_thing_of_similar_colour() {
    let mut tracker = tracker();
    let mut squares = Vector3::zeros();
    for i in 0..30 {
        let other = ball(Point3::new(0.40, 0.53, 1.0), 0.033, [60, 175, 50]);
        let scene = [table(TABLE), ball(path(i), 0.03, GREEN), other];
        let estimate = tracker.update(&frame(&scene, stamp(i), i), None).unwrap();
        let e = error(&estimate, &path(i));
        squares += e.component_mul(&e) / 30.0;
        assert!(estimate.visible > 0.9);
    }
    let rms = squares.map(f64::sqrt);
    assert!(rms.x < 0.003 && rms.y < 0.003 && rms.z < 0.008, "{rms}");
}

#[test]
fn a_level_box_is_seen_at_its_centre_whichever_way_it_is_turned_in_the_mean() {
    let (size, at) = (Vector3::new(0.10, 0.07, 0.04), Point3::new(0.28, 0.53, 1.15));
    let mean = |tracker: ColorMarkerObjectTracking| {
        let errors = (0..8).map(|turn| {
            let yaw = Vector3::z() * std::f64::consts::PI * f64::from(turn) / 8.0;
            let tool = Thing::Block { root_from_block: Isometry3::new(at.coords, yaw), size, color: GREEN };
            let estimate = tracker.clone().update(&frame(&[table(TABLE), tool], 0, 0), None).unwrap();
            root_from_left() * error(&estimate, &at)
        });
        errors.sum::<Vector3<f64>>() / 8.0
    };
    let (round, level) = (mean(tracker()), mean(tracker().of_level_box(size)));
    assert!(round.y < -0.002 && level.norm() < 0.001, "{round} {level}");
}

#[test]
fn half_hidden_it_is_less_sure() {
    let mut tracker = tracker();
    let mut before = 0.0;
    for i in 0..12 {
        let at = path(i);
        let mut scene = vec![table(TABLE), ball(at, 0.03, GREEN)];
        if i > 6 {
            let toward = root_from_left().translation.vector - at.coords;
            let screen = at + toward.normalize() * 0.06 + root_from_left() * Vector3::new(0.05, 0.0, 0.0);
            scene.push(ball(screen, 0.05, [120, 120, 120]));
        }
        let estimate = tracker.update(&frame(&scene, stamp(i), i), None).unwrap();
        let e = error(&estimate, &at);
        if i <= 6 {
            before = estimate.covariance.trace();
        } else {
            assert!(estimate.visible < 0.8 && estimate.covariance.trace() > 3.0 * before, "{estimate:?}");
            assert!(e.norm() < 0.03);
            let distance = e.dot(&(estimate.covariance.try_inverse().unwrap() * e));
            assert!(distance < 16.0, "{distance}");
        }
    }
}

#[test]
fn a_lost_marker_is_found_again_elsewhere() {
    let mut tracker = tracker();
    let nothing = [table(TABLE)];
    for i in 0..40 {
        let at = if i < 5 { path(0) } else { Point3::new(0.1, 0.6, 1.0) };
        let hidden = (5..20).contains(&i);
        let scene = [table(TABLE), ball(at, 0.03, GREEN)];
        let seen = tracker.update(&frame(if hidden { &nothing } else { &scene }, stamp(i), i), None);
        assert_eq!(seen.is_none(), hidden, "frame {i}");
        if let Some(estimate) = seen {
            assert!(error(&estimate, &at).norm() < 0.02, "frame {i}");
        }
    }
}

#[test]
fn what_is_where_it_should_be_is_preferred() {
    let small = Point3::new(0.20, 0.50, 1.0);
    let scene = [table(TABLE), ball(small, 0.012, GREEN), ball(Point3::new(0.45, 0.60, 1.0), 0.05, GREEN)];
    let frame = frame(&scene, 0, 1);
    let anywhere = tracker().update(&frame, None).unwrap();
    assert!(error(&anywhere, &small).norm() > 0.2);
    let place = root_from_left().inverse() * (small + Vector3::new(0.02, -0.02, 0.02));
    let there = tracker().update(&frame, Some(&place)).unwrap();
    assert!(error(&there, &small).norm() < 0.01, "{there:?}");
    let elsewhere = root_from_left().inverse() * Point3::new(-0.2, 0.5, 1.0);
    assert!(tracker().update(&frame, Some(&elsewhere)).is_some());
}

#[test]
fn nothing_is_seen_where_nothing_is() {
    let mut tracker = tracker();
    for frame in empty_frames() {
        assert_eq!(tracker.update(&frame, None), None);
    }
}

#[test]
fn the_same_seed_gives_the_same_track() {
    let run = || {
        let mut tracker = tracker();
        (0..4)
            .map(|i| tracker.update(&frame(&[ball(path(i), 0.03, GREEN)], stamp(i), i), None))
            .collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}
