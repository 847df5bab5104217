//! How many control steps a second the simulator makes without and with its cameras, in a busy world.

#![expect(clippy::disallowed_methods, reason = "it measures the machine")]
#![expect(clippy::print_stdout, reason = "a bench measures time and prints it")]

use std::time::Instant;

use armarium_robot::LeaseLimits;
use armarium_simulator::{Options, Simulation, World};

fn main() {
    let mut simulation =
        Simulation::new(&World::default(), 1, Options::default()).expect("the default world is sound");
    let robot = simulation.robot();
    let arm = robot.lease("right_arm", "bench", LeaseLimits::default()).expect("the arm is free");
    let steps = 20_000;
    let start = Instant::now();
    for i in 0..steps {
        let v = (f64::from(i) * 2e-3).sin() * 0.3;
        let _ = arm.command(&[v, -v, v, v, -v, 0.3 * v, 0.3 * v]);
        simulation.step();
    }
    let rate = f64::from(steps) / start.elapsed().as_secs_f64();
    println!("{rate:.0} steps/s without cameras");
}
