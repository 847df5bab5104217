//! The area that the object in the hand cleaned: cells of the table under its pressed underside.

use std::f64::consts::TAU;

use super::Mark;
use super::figures::RunLog;
use crate::foundation::ElasticFoundation;
use crate::table::WIPE_EVERY;
use crate::table::{DirtGrid, TableTop};

/// Cells of the table, all in one grid.
#[derive(Clone, Debug, PartialEq)]
pub struct WipedCells {
    /// Cells that the object's footprint sweeps with the TCP on the coach's path.
    pub swept: DirtGrid,
    /// Cells that were cleaned before the coach first acted.
    pub cleaned: DirtGrid,
    /// Cells that were cleaned in the whole run.
    pub cleaned_in_the_end: DirtGrid,
}

impl RunLog<'_> {
    /// The footprint is that of the object as the hand holds it (its place and yaw in the hand at the end of
    /// adaptation), with the TCP on the coach's path. Cells count as cleaned by the elastic pressure at the
    /// object's true poses, every 5 ms.
    pub(super) fn wiped(&self) -> Option<WipedCells> {
        let (ended, _) = self.marked(|m| matches!(m, Mark::AdaptationEnded { .. }))?;
        let record = self.log.at(ended)?;
        let (object, pose) = record.object?;
        let spec = self.world.objects.get(object)?;
        let tcp_from_object = record.tcp.inverse() * pose;
        let (table, bed) = (TableTop::new(&self.world.table), ElasticFoundation::new(spec));
        let mut swept = DirtGrid::new(&table);
        for i in 0..360 {
            let [x, y] = self.path.point(TAU * f64::from(i) / 360.0);
            let mut tcp = record.tcp;
            (tcp.translation.x, tcp.translation.y) = (x, y);
            bed.cover(&table, &(tcp * tcp_from_object), &mut swept);
        }
        let wipe = |from: u64, to: u64, cells: &mut DirtGrid| {
            let step = WIPE_EVERY * 1_000_000;
            for r in self.log.between(from, to) {
                if r.stamp_ns.is_multiple_of(step)
                    && r.normal > 0.0
                    && let Some((other, pose)) = &r.object
                    && *other == object
                {
                    bed.wipe(&table, pose, cells);
                }
            }
        };
        let mut cleaned = DirtGrid::new(&table);
        wipe(0, self.coaching_ns(), &mut cleaned);
        let mut cleaned_in_the_end = cleaned.clone();
        wipe(self.coaching_ns(), u64::MAX, &mut cleaned_in_the_end);
        Some(WipedCells { swept, cleaned, cleaned_in_the_end })
    }
}
