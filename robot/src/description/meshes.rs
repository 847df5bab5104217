//! Finds and reads the mesh files of a URDF: STL, OBJ and DAE (COLLADA).
//!
//! `package://NAME/PATH` is searched in the given folders of packages, then in the folders above the URDF, where a folder
//! NAME is the package. A mesh that cannot be used is left out, and a warning says so. Colours and textures inside of mesh
//! files are not used, and neither is COLLADA's `up_axis`.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mesh_loader::Loader;
use nalgebra::{Point3, Vector3};

use crate::Mesh;

/// Largest file, bytes.
const MAX_BYTES: u64 = 200_000_000;
/// Most triangles of one file.
const MAX_TRIANGLES: usize = 2_000_000;

/// Reads meshes, each file once.
pub(super) struct Meshes<'a> {
    /// The URDF's path.
    pub(super) beside: &'a Path,
    /// Folders of packages.
    pub(super) packages: &'a [PathBuf],
    /// Files that were read, by what the URDF calls them and their scale.
    read: BTreeMap<(String, [u64; 3]), Result<Arc<Mesh>, MeshError>>,
}

/// Why a mesh cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum MeshError {
    /// It is not there.
    #[error("meshes that are not found and not drawn")]
    Missing,
    /// It is of another kind, or broken.
    #[error("meshes that cannot be read and are not drawn")]
    Unreadable,
}

impl<'a> Meshes<'a> {
    pub(super) fn new(beside: &'a Path, packages: &'a [PathBuf]) -> Self {
        Self { beside, packages, read: BTreeMap::new() }
    }

    /// The mesh of a file as the URDF names it, scaled.
    pub(super) fn get(&mut self, name: &str, scale: [f64; 3]) -> Result<Arc<Mesh>, MeshError> {
        let key = (name.to_owned(), scale.map(f64::to_bits));
        if let Some(known) = self.read.get(&key) {
            return known.clone();
        }
        let path = self.find(name).ok_or(MeshError::Missing);
        let mesh = path.and_then(|path| load(&path, &Vector3::from(scale)).ok_or(MeshError::Unreadable));
        self.read.insert(key, mesh.clone());
        mesh
    }

    fn find(&self, name: &str) -> Option<PathBuf> {
        self.candidates(name).into_iter().find(|path| path.is_file())
    }

    fn candidates(&self, name: &str) -> Vec<PathBuf> {
        let folder = self.beside.parent().unwrap_or(Path::new(""));
        let Some(inside) = name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) else {
            return vec![folder.join(name.strip_prefix("file://").unwrap_or(name))];
        };
        // Some write three slashes.
        let inside = inside.trim_start_matches('/');
        let path = inside.split_once('/').map_or(inside, |(_, path)| path);
        let package = inside.split('/').next().unwrap_or("");
        let given = self.packages.iter().flat_map(|folder| [folder.join(inside), folder.join(path)]);
        let whole = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        let above = whole.ancestors().flat_map(|above| {
            let own = above.file_name().is_some_and(|name| name == package);
            [Some(above.join(inside)), own.then(|| above.join(path))]
        });
        given.chain(above.flatten()).collect()
    }
}

/// Reads a mesh file: STL, OBJ or DAE, in m. `None` when it is not there or cannot be read.
pub fn mesh_file(path: &Path) -> Option<Arc<Mesh>> {
    load(path, &Vector3::repeat(1.0))
}

fn load(path: &Path, scale: &Vector3<f64>) -> Option<Arc<Mesh>> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).ok()?;
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes).ok().filter(|read| *read as u64 <= MAX_BYTES)?;
    read(&bytes, path, scale).map(Arc::new)
}

/// Reads the bytes of a mesh file, whose kind follows from its name; `None` when they are none.
pub(super) fn read(bytes: &[u8], path: &Path, scale: &Vector3<f64>) -> Option<Mesh> {
    // Materials of OBJ files are files of their own, which are not needed.
    let nothing = |_: &Path| Err(std::io::ErrorKind::Unsupported.into());
    let scene = Loader::default().load_from_slice_with_reader(bytes, path, nothing).ok()?;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for mesh in scene.meshes {
        let first = u32::try_from(vertices.len()).ok()?;
        vertices.extend(mesh.vertices.iter().map(|v| {
            let point = Vector3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]));
            Point3::from(point.component_mul(scale))
        }));
        for face in mesh.faces {
            let at = |corner: usize| first.checked_add(face[corner]);
            triangles.push([at(0)?, at(1)?, at(2)?]);
        }
    }
    if triangles.len() > MAX_TRIANGLES {
        return None;
    }
    Mesh::new(vertices, triangles)
}
