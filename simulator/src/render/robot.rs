//! The shapes of a robot: the visuals of its description in a configuration.

use std::sync::Arc;

use armarium_robot::{Geometry, Kinematics, Visual};
use nalgebra::Isometry3;

use super::scene::{Shape, VisibleForm};

/// All links of a robot at the configuration of `kinematics`, with its root at `scene_from_root`.
pub fn robot_shapes(kinematics: &Kinematics, scene_from_root: &Isometry3<f64>) -> Vec<Shape> {
    let model = kinematics.model();
    let links = model.links().iter().filter_map(|link| Some((link, model.link(&link.name)?)));
    links
        .flat_map(|(link, id)| link_shapes(&link.visuals, &(scene_from_root * kinematics.pose(id))))
        .collect()
}

/// The visuals of one link that stands at `scene_from_link`.
pub fn link_shapes(visuals: &[Visual], scene_from_link: &Isometry3<f64>) -> Vec<Shape> {
    let pose = |visual: &Visual| scene_from_link * visual.link_from_shape;
    let shape = |visual: &Visual| Shape::new(geometry(&visual.shape), pose(visual), visual.color);
    visuals.iter().map(shape).collect()
}

fn geometry(form: &Geometry) -> VisibleForm {
    match *form {
        Geometry::Box { size } => VisibleForm::Box { half: size / 2.0 },
        Geometry::Cylinder { radius, length } => VisibleForm::Cylinder { radius, half_length: length / 2.0 },
        Geometry::Sphere { radius } => VisibleForm::Sphere { radius },
        Geometry::Mesh(ref mesh) => VisibleForm::Mesh { mesh: Arc::clone(mesh) },
        Geometry::Capsule { radius, length } => VisibleForm::Capsule { radius, half_length: length / 2.0 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armarium_robot::Model;

    #[test]
    fn every_visual_of_every_link_is_there_where_the_link_is() {
        let model = Model::shipped("armar3").unwrap();
        let kinematics = Kinematics::new(&model);
        let scene_from_root = Isometry3::translation(1.0, 2.0, 0.0);
        let shapes = robot_shapes(&kinematics, &scene_from_root);
        let visuals: Vec<_> = model
            .links()
            .iter()
            .flat_map(|link| link.visuals.iter().map(move |visual| (link, visual)))
            .collect();
        assert_eq!(shapes.len(), visuals.len());
        for (shape, (link, visual)) in shapes.iter().zip(visuals) {
            let id = model.link(&link.name).unwrap();
            let expected = scene_from_root * kinematics.pose(id) * visual.link_from_shape;
            assert!((shape.scene_from_shape.translation.vector - expected.translation.vector).norm() < 1e-12);
            assert_eq!(shape.color, visual.color);
        }
    }
}
