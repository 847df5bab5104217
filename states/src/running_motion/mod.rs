//! A motion while it runs. The skill that executes it owns it; other skills send it edits.
//!
//! - [`RunningMotions`]: the running motions of this process, by their address in memory.
//! - [`MotionOwner`]: for the executing skill. Before each control step, it applies the edits that were sent.
//! - [`MotionEditor`]: for a coach. It sees the motion with all edits sent so far, and sends its own.
//!
//! Edits are differences ([`MotionEdit`]): they add up in any order, and none is lost. Pending edits are kept as
//! one sum, so that they need constant memory. A task beside the control loop writes versions to memory. A version
//! that another writer stores there meanwhile becomes an edit too: its difference from the previous version. Only
//! the owner learns the surface: surface values from other writers are ignored while the motion runs.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::Duration;

use armarium_memoryx::{Changes, EntityId, Memory, MemoryError, Pattern, Snapshot};
use armarium_motion::{DmpState, Motion, MotionEdit, MotionError, PeriodicDmp, SurfaceCorrection};
use armarium_runtime::skill::Failure;
use nalgebra::Isometry3;
use parking_lot::Mutex;
use tokio::sync::Notify;
use tokio::sync::broadcast::error::RecvError;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::motions::{self, failed};

/// The least time between two versions in memory.
const WRITE_INTERVAL: Duration = Duration::from_millis(20);
/// How often writing a version is retried when another writer was faster.
const MAX_RETRIES: usize = 8;

/// The running motions of this process; clones share them.
#[derive(Clone, Debug, Default)]
pub struct RunningMotions(Arc<Mutex<BTreeMap<EntityId, Weak<SharedMotion>>>>);

/// The data that owner, editors and recorder of one motion share.
#[derive(Debug)]
struct SharedMotion {
    state: Mutex<SharedState>,
    /// Notified at each edit.
    edited: Arc<Notify>,
}

#[derive(Debug)]
struct SharedState {
    /// The motion with all edits, including those that the owner has not applied yet, at the phase of its last
    /// step.
    view: PeriodicDmp,
    /// Present frequency, rad/s.
    omega: f64,
    /// Where the motion is played: a pose of its own frame in the root frame.
    root_from_motion: Isometry3<f64>,
    /// The robot's time at the owner's last step, ns.
    stamp_ns: u64,
    /// The sum of the edits that the owner has not applied yet.
    pending: MotionEdit,
    /// Whether the view has changed since it was last written to memory.
    unwritten: bool,
    /// Whether the execution has ended, so that edits are refused.
    ended: bool,
    /// Why a version of another writer cannot be applied.
    refused: Option<Failure>,
}

impl SharedState {
    fn edit(&mut self, edit: &MotionEdit) -> Result<(), MotionError> {
        edit.apply(&mut self.view)?;
        self.pending.add(edit)
    }
}

impl RunningMotions {
    /// Makes the caller the owner of a motion, in its newest version in memory, unless another skill runs it.
    pub(crate) async fn own(&self, memory: &Arc<dyn Memory>, id: &EntityId) -> Result<MotionOwner, Failure> {
        // Subscribed before reading, so that no version is missed in between.
        let updates = memory.subscribe(&Pattern::entity(id)).await.map_err(failed)?;
        let (motion, version) = motions::load(&**memory, id).await?;
        let dmp = motion.primitive().clone();
        let state = SharedState {
            view: dmp.clone(),
            omega: 0.0,
            root_from_motion: Isometry3::identity(),
            stamp_ns: 0,
            pending: MotionEdit::none(&dmp),
            unwritten: false,
            ended: false,
            refused: None,
        };
        let edited = Arc::new(Notify::new());
        let shared = Arc::new(SharedMotion { state: Mutex::new(state), edited: Arc::clone(&edited) });
        {
            let mut running = self.0.lock();
            running.retain(|_, shared| shared.strong_count() > 0);
            if running.contains_key(id) {
                return Err(Failure::new(format!("the motion `{id}` is already being executed")));
            }
            running.insert(id.clone(), Arc::downgrade(&shared));
        }
        let stop = CancellationToken::new();
        let (memory, id, written) = (Arc::clone(memory), id.clone(), motion.clone());
        let recorder = MotionRecorder { memory, id, shared: Arc::downgrade(&shared), written, version };
        let task = tokio::spawn(recorder.follow(updates, edited, stop.clone()));
        Ok(MotionOwner { shared, motion, dmp, recorder: Some(task), stop })
    }

    /// Access to edit a motion that a skill in this process executes.
    pub(crate) fn edit(&self, id: &EntityId) -> Result<MotionEditor, Failure> {
        let editor = MotionEditor { shared: self.0.lock().get(id).cloned().unwrap_or_default() };
        editor.view().map(|_| editor)
    }
}

fn not_running() -> Failure {
    Failure::new("no motion is running that could be coached")
}

/// The motion of the executing skill.
pub(crate) struct MotionOwner {
    shared: Arc<SharedMotion>,
    motion: Motion,
    dmp: PeriodicDmp,
    recorder: Option<JoinHandle<MotionRecorder>>,
    stop: CancellationToken,
}

impl MotionOwner {
    /// The motion as it was when it began to run.
    pub(crate) fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Says where the motion is played: the pose of its own frame in the root frame. By default they are the same.
    pub(crate) fn set_frame(&self, root_from_motion: Isometry3<f64>) {
        self.shared.state.lock().root_from_motion = root_from_motion;
    }

    /// The middle of the motion as it is now, x and y in its own frame, m.
    pub(crate) fn middle(&self) -> [f64; 2] {
        let centre = self.dmp.centre();
        [centre[0], centre[1]]
    }

    /// The state of the primitive.
    pub(crate) fn state(&self) -> DmpState<'_> {
        self.dmp.state()
    }

    /// Sets the primitive to its steady path at `phase` rad.
    pub(crate) fn start_on_path(&mut self, phase: f64) -> Result<(), Failure> {
        self.dmp.start_on_path(phase, self.motion.omega()).map_err(failed)?;
        self.shared.state.lock().view.set_phase(phase).map_err(failed)
    }

    /// Applies the pending edits, and advances by `dt` s at `omega` rad/s. `stamp_ns` is the robot's time. Fails where the step is
    /// refused, or another writer stored a version that cannot be executed.
    pub(crate) fn step(&mut self, dt: f64, omega: f64, stamp_ns: u64) -> Result<(), Failure> {
        {
            let mut state = self.shared.state.lock();
            if let Some(failure) = state.refused.take() {
                return Err(failure);
            }
            if !state.pending.is_empty() {
                let SharedState { view, pending, .. } = &mut *state;
                pending.apply(&mut self.dmp).map_err(failed)?;
                pending.clear();
                // Sums of differences have rounding errors: the running weights are the reference.
                view.set_weights(self.dmp.weights()).map_err(failed)?;
                view.set_centre(self.dmp.centre()).map_err(failed)?;
            }
        }
        let phase = self.dmp.step(dt, omega).map_err(failed)?.phase;
        let mut state = self.shared.state.lock();
        (state.omega, state.stamp_ns) = (omega, stamp_ns);
        state.view.set_phase(phase).map_err(failed)
    }

    /// Sets the third coordinate of the centre, m.
    pub(crate) fn set_height(&mut self, z: f64) -> Result<(), Failure> {
        let mut state = self.shared.state.lock();
        let mut raised = state.view.clone();
        let mut centre = raised.centre().to_vec();
        if let Some(height) = centre.get_mut(2) {
            *height = z;
        }
        raised.set_centre(&centre).map_err(failed)?;
        let edit = MotionEdit::between(&state.view, &raised).map_err(failed)?;
        state.unwritten = true;
        state.edit(&edit).map_err(failed)
    }

    /// Ends the execution; edits are refused from now on. Writes what has changed since the last version: the
    /// edits, and the learned surface. `learned_from` names the source of learning, if it was not coaching.
    pub(crate) async fn finish(
        mut self,
        surface: Option<&SurfaceCorrection>,
        learned_from: Option<&str>,
    ) -> Result<(), Failure> {
        self.shared.state.lock().ended = true;
        self.stop.cancel();
        let Some(task) = self.recorder.take() else { return Ok(()) };
        let mut recorder = task.await.map_err(failed)?;
        recorder.write(surface, learned_from).await
    }
}

impl Drop for MotionOwner {
    fn drop(&mut self) {
        if let Some(task) = &self.recorder {
            task.abort();
        }
    }
}

/// A coach's access to a motion that another skill executes.
#[derive(Debug)]
pub(crate) struct MotionEditor {
    shared: Weak<SharedMotion>,
}

impl MotionEditor {
    /// The motion with all edits sent so far.
    pub(crate) fn view(&self) -> Result<PeriodicDmp, Failure> {
        Ok(self.shared.upgrade().ok_or_else(not_running)?.state.lock().view.clone())
    }

    /// Where the motion is played: the pose of its own frame in the root frame.
    pub(crate) fn frame(&self) -> Result<Isometry3<f64>, Failure> {
        Ok(self.shared.upgrade().ok_or_else(not_running)?.state.lock().root_from_motion)
    }

    /// Applies `change` to the present motion (with its present frequency, rad/s), and sends the difference to the owner, as long as the
    /// motion runs. `change` must be quick: the owner's control step waits for it.
    pub(crate) fn edit<T>(
        &self,
        change: impl FnOnce(&mut PeriodicDmp, f64) -> Result<T, MotionError>,
    ) -> Result<T, Failure> {
        let shared = self.shared.upgrade().ok_or_else(not_running)?;
        let mut state = shared.state.lock();
        if state.ended {
            return Err(not_running());
        }
        let (before, omega) = (state.view.clone(), state.omega);
        let result = change(&mut state.view, omega).map_err(failed)?;
        let edit = MotionEdit::between(&before, &state.view).map_err(failed)?;
        // The view contains the change already; the owner applies it before its next step.
        if !edit.is_empty() {
            state.pending.add(&edit).map_err(failed)?;
            state.unwritten = true;
            shared.edited.notify_one();
        }
        Ok(result)
    }
}

/// Writes versions of a running motion to memory, and applies those of other writers.
struct MotionRecorder {
    memory: Arc<dyn Memory>,
    id: EntityId,
    shared: Weak<SharedMotion>,
    /// The newest version in memory that is known here.
    written: Motion,
    version: u64,
}

impl MotionRecorder {
    /// Processes memory updates and edits until it is stopped. It locks the motion only while it reads or writes
    /// it.
    async fn follow(mut self, mut updates: Changes, edited: Arc<Notify>, stop: CancellationToken) -> Self {
        loop {
            tokio::select! {
                biased;
                () = stop.cancelled() => return self,
                update = updates.recv() => match update {
                    Ok(snapshot) => self.take(&snapshot),
                    Err(RecvError::Lagged(_)) => {
                        let caught_up = self.catch_up().await;
                        self.log(caught_up);
                    }
                    Err(RecvError::Closed) => {
                        stop.cancelled().await;
                        return self;
                    }
                },
                () = edited.notified() => {
                    let written = self.write(None, None).await;
                    self.log(written);
                    tokio::select! {
                        biased;
                        () = stop.cancelled() => return self,
                        () = tokio::time::sleep(WRITE_INTERVAL) => {}
                    }
                }
            }
        }
    }

    fn log(&self, done: Result<(), Failure>) {
        if let Err(failure) = done {
            tracing::warn!("the motion `{}` and its versions in memory differ: {}", self.id, failure.reason);
        }
    }

    /// Converts a version of another writer to an edit of the running motion.
    fn take(&mut self, snapshot: &Snapshot) {
        if snapshot.id != self.id || snapshot.version <= self.version {
            return;
        }
        let Some(shared) = self.shared.upgrade() else { return };
        let edit = motions::motion_of(snapshot).and_then(|motion| {
            let edit = MotionEdit::between(self.written.primitive(), motion.primitive()).map_err(failed)?;
            shared.state.lock().edit(&edit).map_err(failed)?;
            Ok(motion)
        });
        match edit {
            Ok(motion) => (self.written, self.version) = (motion, snapshot.version),
            Err(failure) => shared.state.lock().refused = Some(failure),
        }
    }

    /// Applies the newest version in memory.
    async fn catch_up(&mut self) -> Result<(), Failure> {
        let newest = self.memory.latest(&self.id).await.map_err(failed)?;
        self.take(&newest);
        Ok(())
    }

    /// Writes the motion with all edits as the next version, if it has changed. A version that another writer
    /// stored meanwhile is applied first.
    async fn write(
        &mut self,
        surface: Option<&SurfaceCorrection>,
        learned_from: Option<&str>,
    ) -> Result<(), Failure> {
        let Some(shared) = self.shared.upgrade() else { return Ok(()) };
        for _ in 0..MAX_RETRIES {
            let (view, edited, stamp_ns) = {
                let mut state = shared.state.lock();
                (state.view.clone(), std::mem::take(&mut state.unwritten), state.stamp_ns)
            };
            if !edited && surface.is_none() {
                return Ok(());
            }
            let before = if edited { "coaching" } else { self.written.learned_from() };
            let next = self.written.next_version(view, learned_from.unwrap_or(before)).map_err(failed)?;
            let next = match surface {
                Some(surface) => next.with_surface(Some(surface.clone())),
                None => next,
            };
            let commit = motions::commit(&self.id, &next, stamp_ns, Some(self.version))?;
            match self.memory.commit(vec![commit]).await {
                Ok(versions) => {
                    self.version = versions.first().copied().unwrap_or(self.version);
                    self.written = next;
                    return Ok(());
                }
                Err(error) => {
                    shared.state.lock().unwritten |= edited;
                    if !matches!(error, MemoryError::Conflict { .. }) {
                        return Err(failed(error));
                    }
                    self.catch_up().await?;
                }
            }
        }
        let id = &self.id;
        Err(Failure::new(format!("the motion `{id}` is changed by others faster than it can be written")))
    }
}

#[cfg(test)]
mod tests;
