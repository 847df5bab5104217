//! Eight numbers at a time, by the widest vectors that the processor has.
//!
//! Each product and each sum is rounded by itself, also where the processor could do both in one instruction: so what it offers changes
//! no bit of a result, only the time.

use wide::f32x8;

/// Numbers in a vector.
pub(super) const LANES: usize = 8;

/// Vectors of eight numbers.
pub(super) trait Lanes: Copy {
    /// A vector.
    type Vector: Copy;
    /// Whether eight sums fit into half of the registers.
    const EIGHT_SUMS: bool;

    fn load(self, values: [f32; LANES]) -> Self::Vector;
    fn splat(self, value: f32) -> Self::Vector;
    /// `sum + a * b`, rounded after the product and after the sum.
    fn add_product(self, sum: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn store(self, vector: Self::Vector) -> [f32; LANES];
}

/// What every processor of this kind has.
#[derive(Clone, Copy)]
pub(super) struct Common;

impl Lanes for Common {
    type Vector = f32x8;
    const EIGHT_SUMS: bool = cfg!(target_arch = "aarch64");

    #[inline(always)]
    fn load(self, values: [f32; LANES]) -> f32x8 {
        f32x8::from(values)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> f32x8 {
        f32x8::splat(value)
    }

    #[inline(always)]
    fn add_product(self, sum: f32x8, a: f32x8, b: f32x8) -> f32x8 {
        sum + a * b
    }

    #[inline(always)]
    fn store(self, vector: f32x8) -> [f32; LANES] {
        vector.to_array()
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for pulp::x86::V3 {
    type Vector = pulp::f32x8;
    const EIGHT_SUMS: bool = true;

    #[inline(always)]
    fn load(self, values: [f32; LANES]) -> pulp::f32x8 {
        pulp::cast(values)
    }

    #[inline(always)]
    fn splat(self, value: f32) -> pulp::f32x8 {
        self.splat_f32x8(value)
    }

    #[inline(always)]
    fn add_product(self, sum: pulp::f32x8, a: pulp::f32x8, b: pulp::f32x8) -> pulp::f32x8 {
        self.add_f32x8(sum, self.mul_f32x8(a, b))
    }

    #[inline(always)]
    fn store(self, vector: pulp::f32x8) -> [f32; LANES] {
        pulp::cast(vector)
    }
}

/// Work on vectors; all that it calls has to be inlined.
pub(super) trait OnLanes {
    fn run<L: Lanes>(self, lanes: L);
}

/// Does some work with the widest vectors that the processor has.
pub(super) fn on_widest(work: impl OnLanes) {
    #[cfg(target_arch = "x86_64")]
    if let Some(lanes) = pulp::x86::V3::try_new() {
        return lanes.vectorize(Widest(lanes, work));
    }
    work.run(Common);
}

#[cfg(target_arch = "x86_64")]
struct Widest<W>(pulp::x86::V3, W);

#[cfg(target_arch = "x86_64")]
impl<W: OnLanes> pulp::NullaryFnOnce for Widest<W> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.1.run(self.0);
    }
}
