//! A change of a primitive, as differences of its weights and its centre. Differences add up in any order, so that
//! simultaneous changes by several coaches are all kept.
//!
//! It contains neither the reason of a change nor state nor constants.

use crate::error::{MotionError, size};
use crate::periodic::PeriodicDmp;

/// Differences to add to weights and centre of a [`PeriodicDmp`].
#[derive(Debug, Clone, PartialEq)]
pub struct MotionEdit {
    weights: Vec<f64>,
    centre: Vec<f64>,
    empty: bool,
}

impl MotionEdit {
    /// An empty change, for primitives of the size of `dmp`.
    pub fn none(dmp: &PeriodicDmp) -> Self {
        Self { weights: vec![0.0; dmp.weights().len()], centre: vec![0.0; dmp.dofs()], empty: true }
    }

    /// The change from `before` to `after`.
    ///
    /// # Errors
    /// [`MotionError::Size`] when the two differ in the number of weights or degrees of freedom.
    pub fn between(before: &PeriodicDmp, after: &PeriodicDmp) -> Result<Self, MotionError> {
        let mut edit = Self::none(before);
        edit.add_difference(before.weights(), before.centre(), after)?;
        Ok(edit)
    }

    /// Adds the change from `weights` and `centre` to those of `after`. Does not allocate.
    ///
    /// # Errors
    /// [`MotionError::Size`] when sizes differ; nothing is changed then.
    pub fn add_difference(
        &mut self,
        weights: &[f64],
        centre: &[f64],
        after: &PeriodicDmp,
    ) -> Result<(), MotionError> {
        self.check(after)?;
        size("weights", self.weights.len(), weights.len())?;
        size("centre", self.centre.len(), centre.len())?;
        let differences =
            [(&mut self.weights, weights, after.weights()), (&mut self.centre, centre, after.centre())];
        for (edit, before, after) in differences {
            for ((e, b), a) in edit.iter_mut().zip(before).zip(after) {
                self.empty &= a == b;
                *e += a - b;
            }
        }
        Ok(())
    }

    /// Adds another change. Does not allocate.
    ///
    /// # Errors
    /// [`MotionError::Size`] when sizes differ; nothing is changed then.
    pub fn add(&mut self, other: &Self) -> Result<(), MotionError> {
        size("weights", self.weights.len(), other.weights.len())?;
        size("centre", self.centre.len(), other.centre.len())?;
        add(&mut self.weights, &other.weights);
        add(&mut self.centre, &other.centre);
        self.empty &= other.empty;
        Ok(())
    }

    /// Whether all differences are zero.
    pub fn is_empty(&self) -> bool {
        self.empty
    }

    /// Sets all differences to zero. Does not allocate.
    pub fn clear(&mut self) {
        self.weights.fill(0.0);
        self.centre.fill(0.0);
        self.empty = true;
    }

    /// Applies the change to `dmp`. Its state is unchanged, so that the position does not jump. Does not allocate.
    ///
    /// # Errors
    /// [`MotionError::Size`] when sizes differ; nothing is changed then.
    pub fn apply(&self, dmp: &mut PeriodicDmp) -> Result<(), MotionError> {
        self.check(dmp)?;
        if !self.empty {
            add(dmp.weights_mut(), &self.weights);
            add(dmp.centre_mut(), &self.centre);
        }
        Ok(())
    }

    fn check(&self, dmp: &PeriodicDmp) -> Result<(), MotionError> {
        size("weights", self.weights.len(), dmp.weights().len())?;
        size("centre", self.centre.len(), dmp.dofs())
    }
}

fn add(to: &mut [f64], difference: &[f64]) {
    to.iter_mut().zip(difference).for_each(|(t, d)| *t += d);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PeriodicDmpConfig;

    fn primitive(weight: f64, centre: f64) -> PeriodicDmp {
        let mut dmp = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(1)).unwrap();
        dmp.set_weights(&[weight; 25]).unwrap();
        dmp.set_centre(&[centre]).unwrap();
        dmp
    }

    #[test]
    fn changes_add_up_in_any_order() {
        let base = primitive(1.0, 0.0);
        let one = MotionEdit::between(&base, &primitive(1.5, 0.0)).unwrap();
        let two = MotionEdit::between(&base, &primitive(0.75, 0.25)).unwrap();
        let (mut first, mut second) = (base.clone(), base.clone());
        for (dmp, edits) in [(&mut first, [&one, &two]), (&mut second, [&two, &one])] {
            edits.iter().for_each(|e| e.apply(dmp).unwrap());
        }
        assert_eq!(first.weights(), [1.25; 25]);
        assert_eq!(first.centre(), [0.25]);
        assert_eq!((first.weights(), first.centre()), (second.weights(), second.centre()));
        let mut both = one.clone();
        both.add(&two).unwrap();
        let mut together = base.clone();
        both.apply(&mut together).unwrap();
        assert_eq!(together.weights(), first.weights());
        both.clear();
        assert!(both.is_empty() && !one.is_empty());
    }

    #[test]
    fn another_size_is_refused() {
        let other = PeriodicDmp::new(PeriodicDmpConfig::with_dofs(2)).unwrap();
        assert!(MotionEdit::between(&primitive(1.0, 0.0), &other).is_err());
        assert!(MotionEdit::none(&other).apply(&mut primitive(1.0, 0.0)).is_err());
        assert!(MotionEdit::none(&other).add(&MotionEdit::none(&primitive(1.0, 0.0))).is_err());
    }
}
