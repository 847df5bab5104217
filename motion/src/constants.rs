//! How the constants of a law are declared: each with its meaning, unit, default and allowed range in one place.

use std::ops::RangeInclusive;

/// The range of a constant that must be positive.
pub(crate) const POSITIVE: RangeInclusive<f64> = f64::MIN_POSITIVE..=f64::MAX;
/// The range of a constant of a linear system such as alpha_z, and of a gain such as P(0): products with other allowed
/// values do not overflow.
pub(crate) const GAIN: RangeInclusive<f64> = 1e-9..=1e9;

/// Declares a struct of constants: `/// meaning, unit` and `name: type = default, range;` for each. The range may be
/// left out.
macro_rules! constants {
    ($(#[$about:meta])* pub struct $name:ident {
        $( $(#[doc = $doc:literal])+ $key:ident: $ty:ty = $default:expr $(, $range:expr)?; )*
    }) => {
        $(#[$about])*
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name { $( $(#[doc = $doc])+ pub $key: $ty, )* }

        impl Default for $name {
            fn default() -> Self {
                Self { $( $key: $default, )* }
            }
        }

        impl $name {
            /// Refuses the first constant that is outside its range.
            #[allow(dead_code, reason = "constants without ranges have nothing to check")]
            pub(crate) fn check_ranges(&self) -> Result<(), crate::error::MotionError> {
                $( $( crate::error::within(stringify!($key), self.$key as f64, *$range.start(), *$range.end())?; )? )*
                Ok(())
            }
        }
    };
}
