//! The referee's report: figures with the names that `report.json` uses. A figure whose data are missing is absent.

use std::collections::BTreeMap;

use serde::Serialize;

/// The referee's figures; the field names are those of the report.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefereeReport {
    /// The grasp.
    pub grasp: Option<GraspFigures>,
    /// The imitation in free space.
    pub imitation: Option<ImitationFigures>,
    /// The contact force after adaptation.
    pub force: Option<ForceFigures>,
    /// Of the area that the footprint of what the hand holds sweeps along the coach's path, the part cleaned before coaching began.
    pub wiped_fraction: Option<f64>,
    /// What coaching changed, one entry for each of the coach's actions that took place.
    pub coaching: Vec<CoachingFigures>,
    /// How often gestures were recognised correctly.
    pub gestures: Option<GestureFigures>,
}

/// The grasp.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GraspFigures {
    /// The object that is judged: the one in the hand when it closed.
    pub object: String,
    /// True pose of the object in the hand less the nominal grasp when closing has ended, m.
    pub position_error_m: f64,
}

/// The imitation in free space.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImitationFigures {
    /// Inverse of the repeat period of the whole learned path, Hz.
    pub frequency_hz: f64,
    /// The frequency that the coach showed, Hz.
    pub demonstrated_frequency_hz: Option<f64>,
    /// True TCP path over one steady period against the coach's true path, m.
    pub path_rms_m: f64,
}

/// The normal force between the object in the hand and the table over the first 5 cycles after adaptation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ForceFigures {
    /// The desired force, N.
    pub desired_n: f64,
    /// Its mean, N.
    pub mean_n: f64,
    /// RMS difference from the desired force, N.
    pub rms_error_n: f64,
    /// Its maximum, N.
    pub max_n: f64,
    /// Total time under 0.2 N, s.
    pub contact_lost_s: f64,
    /// Its maximum in the half second after the first touch, N.
    pub touchdown_max_n: f64,
    /// Cycles spent adapting.
    pub cycles: u32,
}

/// What one action of the coach changed. Figures that its kind does not have, or that were not complete when the
/// run ended, are absent.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoachingFigures {
    /// Index of the step of the world's coaching, from 0.
    pub step: usize,
    /// `push`, `fist`, `point_one`, `point_two` or `open_hand`.
    pub kind: &'static str,
    /// When it began, s of the run.
    pub at_s: f64,
    /// The coached phase, 0 to 1.
    pub phase: f64,
    /// Unit vector of the intended shift, root frame; `None` for the open hand.
    pub direction: Option<[f64; 3]>,
    /// Signed shift of the executed path at the coached phase along the direction, m.
    pub displacement_m: Option<f64>,
    /// Angle between the horizontal shift at the coached phase and the direction, degrees.
    pub direction_error_deg: Option<f64>,
    /// The same shift two cycles after the coach has gone, m.
    pub retained_m: Option<f64>,
    /// RMS shift of the phases more than a quarter period away, m; not for `point_one`.
    pub far_side_rms_m: Option<f64>,
    /// Lowest frequency while the hand was near, over the learned one; `None` for pushes.
    pub slowed_to: Option<f64>,
}

/// How often gestures were recognised correctly.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GestureFigures {
    /// Number of frames that count: with a hand, and as many without.
    pub frames: usize,
    /// Share of them that was recognised correctly.
    pub accuracy: f64,
    /// Recognised gestures, by the gesture that was shown; `none` is no hand.
    pub confusion: BTreeMap<String, BTreeMap<String, u32>>,
}
