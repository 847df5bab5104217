//! Silhouettes of convex bodies.
