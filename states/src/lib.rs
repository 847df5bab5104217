//! The skills: each one a thin state around an algorithm of motion, visionx or robot.
