//! What does not change during a run: its chart, its skills, and the shapes of what the world view shows. A recording has it as the
//! attachment `run.json`, so that the same page can show it later.

use std::collections::BTreeMap;

use armarium_robot::{Geometry, Model};
use armarium_runtime::chart::{Outline, OutlineKind};
use armarium_runtime::skill::{Parameter, SkillManifest};
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};

/// Most triangles of one mesh; of one that has more, the box around it is shown.
const MOST_TRIANGLES: usize = 4000;

/// What does not change during a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunHeader {
    /// The chart's name.
    pub title: String,
    /// World, seed and the like, in a line.
    pub subtitle: String,
    /// The chart, with the charts that it uses unfolded.
    pub outline: Outline,
    /// What the skills that it uses declare, by name, as JSON.
    pub skills: BTreeMap<String, Json>,
    /// What the world view shows.
    pub solids: Vec<Solid>,
}

/// One shape of one colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solid {
    /// The frame that it moves with, as poses name it; `None` stands still in the root frame.
    pub frame: Option<String>,
    /// Its form.
    #[serde(flatten)]
    pub form: SolidForm,
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Its pose in that frame: position, m, and quaternion x, y, z, w.
    pub at: [f32; 7],
    /// Whether it comes and goes: it is shown while its frame has new poses.
    #[serde(default)]
    pub passing: bool,
}

/// The forms of solids; lengths in m.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "form", rename_all = "snake_case")]
#[non_exhaustive]
#[allow(missing_docs, reason = "the names of the fields say what they are")]
pub enum SolidForm {
    /// A box with these edges.
    Box { size: [f32; 3] },
    /// A ball with this radius.
    Sphere { size: [f32; 1] },
    /// A cylinder about z: its radius and length.
    Cylinder { size: [f32; 2] },
    /// A cylinder about z with round ends: its radius, and its length without the ends.
    Capsule { size: [f32; 2] },
    /// A surface of triangles, each of three numbers of vertices.
    Mesh { vertices: Vec<[f32; 3]>, triangles: Vec<[u32; 3]> },
}

impl RunHeader {
    /// As the page reads it: the states by their paths instead of the outline.
    pub(super) fn for_page(&self) -> Json {
        let state = |at: usize| {
            let state = &self.outline.states[at];
            let skill = match &state.kind {
                OutlineKind::Skill(skill) | OutlineKind::Remote(skill) => Some(skill),
                _ => None,
            };
            let inside = !state.children.is_empty();
            let known = json!({
                "description": state.description,
                "skill": skill,
                "inside": inside,
                "written": state.activities,
            });
            (self.outline.path(at), known)
        };
        let states: BTreeMap<String, Json> = (0..self.outline.states.len()).map(state).collect();
        json!({
            "title": self.title,
            "subtitle": self.subtitle,
            "states": states,
            "skills": self.skills,
            "solids": self.solids,
        })
    }
}

/// What a skill declares, for [`RunHeader::skills`].
pub(crate) fn declared(manifest: &SkillManifest) -> Json {
    let one = |parameter: &Parameter| {
        let (name, about) = (&parameter.name, &parameter.description);
        json!({"name": name, "type": parameter.ty.to_string(), "description": about})
    };
    let all = |parameters: &[Parameter]| parameters.iter().map(one).collect::<Vec<_>>();
    let SkillManifest { name, description, .. } = manifest;
    json!({"name": name, "description": description, "inputs": all(&manifest.inputs), "outputs": all(&manifest.outputs),
        "outcomes": manifest.outcomes})
}

impl Solid {
    /// A shape with its pose in a frame.
    pub fn new(frame: Option<&str>, form: SolidForm, at: &Isometry3<f64>, color: [u8; 3]) -> Self {
        let (t, q) = (at.translation.vector, at.rotation.coords);
        let at = [t.x, t.y, t.z, q.x, q.y, q.z, q.w].map(|number| number as f32);
        Self { frame: frame.map(str::to_owned), form, color, at, passing: false }
    }
}

/// The visible shapes of a robot; each moves with the frame of its link's name.
pub fn solids_of(model: &Model) -> Vec<Solid> {
    let links = model.links().iter();
    let shapes = links.flat_map(|link| link.visuals.iter().map(|visual| (link.name.as_str(), visual)));
    shapes
        .map(|(link, visual)| {
            let (form, middle) = form(&visual.shape);
            let at = visual.link_from_shape * nalgebra::Translation3::from(middle);
            Solid::new(Some(link), form, &at, visual.color)
        })
        .collect()
}

/// A form, and where its middle is in the shape's frame.
fn form(shape: &Geometry) -> (SolidForm, Vector3<f64>) {
    let numbers = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
    let form = match *shape {
        Geometry::Box { size } => SolidForm::Box { size: numbers(size) },
        Geometry::Sphere { radius } => SolidForm::Sphere { size: [radius as f32] },
        Geometry::Cylinder { radius, length } => SolidForm::Cylinder { size: [radius as f32, length as f32] },
        Geometry::Capsule { radius, length } => SolidForm::Capsule { size: [radius as f32, length as f32] },
        Geometry::Mesh(ref mesh) if mesh.triangles().len() <= MOST_TRIANGLES => SolidForm::Mesh {
            vertices: mesh.vertices().iter().map(|vertex| numbers(vertex.coords)).collect(),
            triangles: mesh.triangles().to_vec(),
        },
        Geometry::Mesh(ref mesh) => {
            let corners = mesh.bounds();
            let (low, high) = corners.iter().fold(
                (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)),
                |(low, high), corner| (low.inf(&corner.coords), high.sup(&corner.coords)),
            );
            return (SolidForm::Box { size: numbers(high - low) }, (low + high) / 2.0);
        }
    };
    (form, Vector3::zeros())
}

impl RunHeader {
    /// The header of a run.
    pub fn new<'m>(
        (title, subtitle): (&str, String),
        outline: Outline,
        skills: impl Iterator<Item = &'m SkillManifest>,
        solids: Vec<Solid>,
    ) -> Self {
        let used: Vec<&str> = outline
            .states
            .iter()
            .filter_map(|state| match &state.kind {
                OutlineKind::Skill(name) => Some(name.as_str()),
                _ => None,
            })
            .collect();
        let skills = skills
            .filter(|manifest| used.contains(&manifest.name.as_str()))
            .map(|manifest| (manifest.name.clone(), declared(manifest)))
            .collect();
        Self { title: title.to_owned(), subtitle, outline, skills, solids }
    }
}
