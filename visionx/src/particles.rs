//! Particle filter.
