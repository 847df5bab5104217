//! No control step allocates: checked by a counting allocator.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use armarium_motion::{
    Coach, CoachConfig, CoachInput, DiscreteDmpConfig, DiscreteOrientationDmp, FrictionConfig, FrictionModel,
    MotionEdit, PeriodicDmp, PeriodicDmpConfig, PeriodicOrientationDmp, SurfaceAdaptation, SurfaceConfig,
    Touchdown, TouchdownConfig,
};
use nalgebra::Vector3;

fn allocations(mut step: impl FnMut()) -> u64 {
    step();
    allocation_counter::measure(|| (0..2000).for_each(|_| step())).count_total
}

#[test]
fn steps_do_not_allocate() {
    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(7)).unwrap();
    let n = allocations(|| {
        dmp.couple(&[0.01; 7]).unwrap();
        dmp.perturb(&[0.01; 7]).unwrap();
        dmp.learn(1.0, 3.0, 0.001, &[0.1; 7], &[0.0; 7], &[0.0; 7]).unwrap();
        dmp.step(0.001, 3.0).unwrap();
    });
    assert_eq!(n, 0, "primitive");

    let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(3)).unwrap();
    let mut coach = Coach::new(CoachConfig::default(), &dmp).unwrap();
    let mut k = 0;
    let n = allocations(|| {
        let hand = Vector3::new(0.1, 0.0, 0.0);
        let input = match k % 5 {
            0 => CoachInput::None,
            1 => CoachInput::Push { force: Vector3::new(10.0, 0.0, 0.0) },
            2 => CoachInput::Attract { hand },
            3 => CoachInput::Repel { hand },
            _ => CoachInput::Shift { direction: hand },
        };
        k += 1;
        coach.step(&mut dmp, 0.001, 3.0, input).unwrap();
        dmp.step(0.001, 3.0).unwrap();
    });
    assert_eq!(n, 0, "coach");

    let mut turning = PeriodicOrientationDmp::new(PeriodicDmpConfig::default()).unwrap();
    let mut reaching = DiscreteOrientationDmp::new(DiscreteDmpConfig::default()).unwrap();
    let n = allocations(|| {
        turning.step(0.001, 3.0).unwrap();
        reaching.step(0.001, 2.0).unwrap();
    });
    assert_eq!(n, 0, "orientations");

    let (mut edit, before) = (MotionEdit::none(&dmp), dmp.clone());
    let n = allocations(|| {
        dmp.displace(0.3, 0.001, &[0.01; 3]).unwrap();
        edit.add_difference(before.weights(), before.centre(), &dmp).unwrap();
        edit.apply(&mut dmp).unwrap();
        edit.clear();
        dmp.set_weights(before.weights()).unwrap();
    });
    assert_eq!(n, 0, "edits");

    let mut surface = SurfaceAdaptation::new(SurfaceConfig::default()).unwrap();
    let mut phase = 0.0;
    let n = allocations(|| {
        phase += 0.1;
        surface.step(0.005, phase, 20.0, 7.0).unwrap();
    });
    assert_eq!(n, 0, "surface");

    let mut friction = FrictionModel::new(FrictionConfig::default()).unwrap();
    let mut touchdown = Touchdown::new(TouchdownConfig::default()).unwrap();
    let n = allocations(|| {
        friction.step(0.001, 8.0, [0.1, 0.0], [3.0, 0.0]).unwrap();
        touchdown.step(0.001, 2.0).unwrap();
    });
    assert_eq!(n, 0, "friction and touchdown");
}
