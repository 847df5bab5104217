//! Steps that follow a periodic signal, run a discrete-periodic movement or learn its control do not allocate, even
//! when the oscillator starts.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use armarium_motion::{
    AdaptiveOscillator, DiscretePeriodicConfig, DiscretePeriodicDmp, FeedbackError, LearningControl,
    LearningControlConfig, OscillatorConfig, PeriodicDmp, PeriodicDmpConfig, Synchronisation,
    SynchronisationConfig,
};
use nalgebra::Vector6;

fn allocations(mut step: impl FnMut()) -> u64 {
    allocation_counter::measure(|| (0..4000).for_each(|_| step())).count_total
}

#[test]
fn no_step_allocates() {
    let mut oscillator = AdaptiveOscillator::new(OscillatorConfig::with_dims(2)).unwrap();
    let mut phase = 0.0_f64;
    let n = allocations(|| {
        phase += 0.02;
        oscillator.update(0.004, &[phase.sin(), 0.3 * (2.0 * phase).cos()]).unwrap();
    });
    assert_eq!((n, oscillator.starts()), (0, 1), "oscillator");

    let primitive = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(7)).unwrap();
    let config = SynchronisationConfig::default();
    let mut system = Synchronisation::new(config, OscillatorConfig::default(), primitive).unwrap();
    let n = allocations(|| {
        phase += 0.02;
        system.step(0.004, &[phase.sin()]).unwrap();
    });
    assert_eq!((n, system.oscillator().starts()), (0, 1), "synchronisation");

    let config = DiscretePeriodicConfig::with_dofs(4);
    let mut dmp = DiscretePeriodicDmp::new(config, 6.0, 1.0).unwrap();
    let mut control = LearningControl::new(LearningControlConfig::default(), 4, 4000).unwrap();
    let columns = [0, 1, 2, 3].map(|i| Vector6::ith(i, 1.0));
    let (wrench, twist) = (Vector6::repeat(0.1), Vector6::repeat(0.01));
    let n = allocations(|| {
        let mut error = [0.0; 4];
        FeedbackError::default().in_joint_space(&columns, &wrench, &twist, &mut error).unwrap();
        control.step(&mut dmp, 6.0, &error).unwrap();
        dmp.step(0.001, 6.0).unwrap();
    });
    assert_eq!(n, 0, "learning control");
}
