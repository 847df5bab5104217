//! The robot, table, sponge, coach and cameras, in physics; and a referee that alone knows the truth.
