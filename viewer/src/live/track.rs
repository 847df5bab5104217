//! Numbers over time, in bounded memory: when a track is full, every second sample goes, and from then on samples come half as often.

/// Most samples of one track.
const MOST: usize = 8192;
/// Most numbers of one sample.
const MOST_NUMBERS: usize = 512;

/// Samples of some numbers over time.
#[derive(Debug)]
pub(super) struct SampleTrack {
    /// What each number is, for instance `force[0]`.
    pub(super) names: Vec<String>,
    /// Least time between two samples, ns.
    period_ns: u64,
    stamps_ns: Vec<u64>,
    /// The numbers of all samples, one sample after the other.
    numbers: Vec<f32>,
}

impl SampleTrack {
    /// A track without samples.
    pub(super) fn new(mut names: Vec<String>, period_ns: u64) -> Self {
        names.truncate(MOST_NUMBERS);
        Self { names, period_ns, stamps_ns: Vec::new(), numbers: Vec::new() }
    }

    /// Whether a sample of this time would be kept.
    pub(super) fn is_due(&self, stamp_ns: u64) -> bool {
        self.stamps_ns.last().is_none_or(|last| stamp_ns >= last.saturating_add(self.period_ns))
    }

    /// Adds a sample, if one is due. Numbers that are missing are NaN.
    pub(super) fn push(&mut self, stamp_ns: u64, numbers: impl IntoIterator<Item = f64>) {
        if !self.is_due(stamp_ns) {
            return;
        }
        if self.stamps_ns.len() >= MOST {
            self.thin();
        }
        self.stamps_ns.push(stamp_ns);
        let mut numbers = numbers.into_iter().map(|number| number as f32);
        self.numbers.extend((0..self.names.len()).map(|_| numbers.next().unwrap_or(f32::NAN)));
    }

    fn thin(&mut self) {
        let width = self.names.len();
        let kept = (0..self.stamps_ns.len()).step_by(2);
        self.numbers =
            kept.clone().flat_map(|at| self.numbers[at * width..(at + 1) * width].to_vec()).collect();
        self.stamps_ns = kept.map(|at| self.stamps_ns[at]).collect();
        self.period_ns = self.period_ns.saturating_mul(2);
    }

    /// The sample at a time and its own time, ns: the last one before it, or else the first.
    pub(super) fn at(&self, stamp_ns: u64) -> Option<(u64, &[f32])> {
        let at = self.stamps_ns.partition_point(|stamp| *stamp <= stamp_ns).saturating_sub(1);
        let width = self.names.len();
        Some((*self.stamps_ns.get(at)?, &self.numbers[at * width..(at + 1) * width]))
    }

    /// The last sample and its time, ns.
    pub(super) fn last(&self) -> Option<(u64, &[f32])> {
        let stamp = *self.stamps_ns.last()?;
        Some((stamp, &self.numbers[self.numbers.len() - self.names.len()..]))
    }

    /// One of its numbers over time, s.
    pub(super) fn series(&self, name: &str) -> Option<(Vec<f64>, Vec<f64>)> {
        let at = self.names.iter().position(|known| known == name)?;
        let times = self.stamps_ns.iter().map(|stamp| *stamp as f64 * 1e-9).collect();
        let values = self.numbers.iter().skip(at).step_by(self.names.len()).map(|v| f64::from(*v)).collect();
        Some((times, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_hour_at_a_kilohertz_stays_small_and_whole() {
        let mut track = SampleTrack::new(vec!["a".into(), "b".into()], 20_000_000);
        for k in 0..3_600_000_u64 {
            track.push(k * 1_000_000, [k as f64, f64::NAN]);
        }
        assert!(track.stamps_ns.len() <= MOST && track.stamps_ns.len() >= MOST / 2 - 1);
        let (times, values) = track.series("a").unwrap();
        assert!(times[0] == 0.0 && times.last().unwrap() > &3598.0);
        assert!(times.iter().zip(&values).all(|(t, v)| (t * 1000.0 - v).abs() < 1.0));
        let half = track.at(1_800_000_000_000).unwrap().1[0];
        assert!((half - 1_800_000.0).abs() < 1000.0, "{half}");
        assert_eq!((track.at(0).unwrap().1[0], track.series("c")), (0.0, None));
    }
}
