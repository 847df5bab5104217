//! `armarium robot new|check|show|list`: the files that describe robots. Running ones are in `robot_service`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use armarium_robot::description::{self, Description, shipped_robots};
use armarium_robot::{JointKind, Kinematics, Model};
use armarium_simulator::render::robot::robot_shapes;
use armarium_simulator::render::{Viewpoint, VisibleScene, render as draw};
use armarium_visionx::{PinholeCamera, annotate};
use nalgebra::{Isometry3, Vector3};

use crate::console::show as render;
use crate::described::described;
use crate::failure::CommandFailure;
use crate::robot_service::{self, RobotServeArgs, RobotTestArgs, ScaleArgs};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct RobotArgs {
    #[command(subcommand)]
    command: RobotCommand,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum RobotCommand {
    /// Write a robot file for a URDF, with what can be told from it; guesses are marked.
    New {
        /// The URDF.
        #[arg(value_name = "FILE.urdf")]
        urdf: PathBuf,
        /// Where to write `robot.yaml`; by default beside the URDF.
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// An SRDF, from which groups, end effectors and postures are taken instead of guesses.
        #[arg(long, value_name = "FILE.srdf")]
        semantics: Option<PathBuf>,
        /// A folder in which packages of `package://` are; may be repeated.
        #[arg(long = "package", value_name = "DIR")]
        packages: Vec<PathBuf>,
        /// Overwrite a robot file that is there already.
        #[arg(long)]
        force: bool,
    },
    /// Say what is wrong with a robot, what is assumed, and what is missing for which skill.
    Check {
        /// A robot file, a URDF, or the name of a robot.
        #[arg(value_name = "FILE|NAME")]
        robot: String,
        /// A folder in which packages of `package://` are; may be repeated.
        #[arg(long = "package", value_name = "DIR")]
        packages: Vec<PathBuf>,
    },
    /// Print a robot's parts, and draw it.
    Show {
        /// A robot file, a URDF, or the name of a robot.
        #[arg(value_name = "FILE|NAME")]
        robot: String,
        /// Write a picture (PNG).
        #[arg(short, long, value_name = "FILE.png")]
        output: Option<PathBuf>,
        /// The posture in the picture; by default the one in which it begins.
        #[arg(long, value_name = "NAME")]
        posture: Option<String>,
    },
    /// List the robots that the program carries.
    List,
    /// Own the guard of a driver, so that skills of several processes can use the robot, until Ctrl-C.
    Serve(RobotServeArgs),
    /// Check that a robot, or a driver, keeps the rules that skills and people rely on.
    Test(RobotTestArgs),
    /// Make a robot slower, or as fast as commanded, while it runs.
    Scale(ScaleArgs),
}

/// Runs the subcommand. Returns the exit status: 2 when a file cannot be used.
pub(crate) fn run(args: &RobotArgs, out: &mut dyn Write) -> io::Result<u8> {
    carry_out(&args.command, out).or_else(|failure| failure.say(out))
}

fn carry_out(command: &RobotCommand, out: &mut dyn Write) -> Result<u8, CommandFailure> {
    match command {
        RobotCommand::New { urdf, out: folder, semantics, packages, force } => {
            new((urdf, semantics.as_deref()), folder.as_deref(), packages, *force, out)
        }
        RobotCommand::Check { robot, packages } => Ok(check(&described(robot, packages)?, out)?),
        RobotCommand::Show { robot, output, posture } => {
            show(&described(robot, &[])?.model, output.as_deref(), posture.as_deref(), out)
        }
        RobotCommand::List => Ok(list(out)?),
        RobotCommand::Serve(args) => robot_service::serve(args),
        RobotCommand::Test(args) => robot_service::test(args, out),
        RobotCommand::Scale(args) => robot_service::scale(args, out),
    }
}

fn new(
    (urdf, semantics): (&Path, Option<&Path>),
    folder: Option<&Path>,
    packages: &[PathBuf],
    force: bool,
    out: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    let folder = folder.or(urdf.parent()).unwrap_or(Path::new("")).to_owned();
    let text = description::guessed(urdf, semantics, &folder, packages)?;
    let file = folder.join("robot.yaml");
    if file.exists() && !force {
        return Err(format!("{} is there already; --force overwrites it", file.display()).into());
    }
    std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::write(&file, text))
        .map_err(|error| format!("{} cannot be written: {error}", file.display()))?;
    writeln!(out, "{}: look at what it guessed, then `armarium robot check {0}`", file.display())?;
    Ok(0)
}

fn check(found: &Description, out: &mut dyn Write) -> io::Result<u8> {
    render(&found.warnings, out)?;
    for lack in armarium_states::lacks(&found.model) {
        writeln!(out, "{}: cannot run: {}", lack.what, lack.skills.join(", "))?;
    }
    writeln!(out, "the robot `{}` can be used", found.model.name())?;
    Ok(0)
}

fn show(
    model: &std::sync::Arc<Model>,
    picture: Option<&Path>,
    posture: Option<&str>,
    out: &mut dyn Write,
) -> Result<u8, CommandFailure> {
    writeln!(out, "{}: {} links, {} joints", model.name(), model.links().len(), model.joints().len())?;
    for limb in model.limbs().values() {
        writeln!(out, "  {}", limb.name)?;
        for joint in limb.joints.iter().map(|&joint| &model.joints()[joint]) {
            let unit = if joint.kind == JointKind::Prismatic { "m" } else { "rad" };
            let (name, lower, upper) = (&joint.name, joint.lower, joint.upper);
            writeln!(out, "    {name}: {lower:.3} to {upper:.3} {unit}, {} {unit}/s", joint.velocity)?;
        }
    }
    let q: &[f64] = match posture {
        None => model.start(),
        Some(name) => model.postures().get(name).ok_or_else(|| {
            let known = model.postures().keys().map(String::as_str).collect::<Vec<_>>().join(", ");
            format!("there is no posture `{name}`; there are: {known}")
        })?,
    };
    let Some(picture) = picture else { return Ok(0) };
    let mut kinematics = Kinematics::new(model);
    kinematics.update(q);
    let png = annotate::png(&drawn(&kinematics)).map_err(io::Error::other)?;
    std::fs::write(picture, png)
        .map_err(|error| format!("{} cannot be written: {error}", picture.display()))?;
    writeln!(out, "drawn to {}", picture.display())?;
    Ok(0)
}

/// The robot seen from its front and its left, from as far as it needs.
fn drawn(kinematics: &Kinematics) -> armarium_visionx::RgbImage {
    let model = kinematics.model();
    let places: Vec<Vector3<f64>> = model
        .links()
        .iter()
        .filter_map(|link| Some(kinematics.pose(model.link(&link.name)?).translation.vector))
        .collect();
    let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (low, high) = places.iter().fold(start, |(low, high), p| (low.inf(p), high.sup(p)));
    let (middle, size) = ((low + high) / 2.0, (high - low).norm().max(0.3));
    // A robot whose root is no floor, such as a walking one, is lifted onto it.
    let lift = Vector3::z() * (0.05 - low.z).max(0.0);
    let camera = PinholeCamera { width: 640, height: 480, focal: 515.0, center: [319.5, 239.5] };
    let eye = middle + lift + Vector3::new(0.8, 0.8, 0.45) * size;
    let mut scene =
        VisibleScene::new(robot_shapes(kinematics, &Isometry3::from_parts(lift.into(), Default::default())));
    scene.light = Vector3::new(0.6, 0.3, 0.9);
    let room = size.max(1.0) * 4.0;
    scene.background.lower = Vector3::new(-room, -room, 0.0);
    scene.background.upper = Vector3::new(room, room, room);
    draw(&scene, &Viewpoint::look_at(camera, eye, middle + lift)).image
}

fn list(out: &mut dyn Write) -> io::Result<u8> {
    for (i, name) in shipped_robots().enumerate() {
        let default = if i == 0 { " (of a world that names none)" } else { "" };
        writeln!(out, "{name}{default}")?;
    }
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(command: RobotCommand) -> (u8, String) {
        let mut out = Vec::new();
        let status = run(&RobotArgs { command }, &mut out).unwrap();
        (status, String::from_utf8(out).unwrap())
    }

    fn check(robot: impl Into<String>) -> (u8, String) {
        says(RobotCommand::Check { robot: robot.into(), packages: Vec::new() })
    }

    #[test]
    fn a_robot_that_ships_is_listed_checked_and_drawn() {
        let (status, listed) = says(RobotCommand::List);
        let name = listed.split_whitespace().next().unwrap().to_owned();
        assert_eq!((status, check(&*name).0), (0, 0));
        assert!(!check(&*name).1.contains("cannot run"), "it lacks nothing");
        let (status, said) = check("nobody");
        assert!(status == 2 && said.contains("there is no robot `nobody`") && said.contains(&name), "{said}");

        let folder = tempfile::tempdir().unwrap();
        let picture = folder.path().join("robot.png");
        let show = |posture: Option<&str>| {
            let posture = posture.map(str::to_owned);
            says(RobotCommand::Show { robot: name.clone(), output: Some(picture.clone()), posture })
        };
        let (status, said) = show(None);
        assert!(status == 0 && said.contains("elbow_r: -2.000 to 0.960 rad, 1 rad/s"), "{said}");
        assert!(std::fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
        assert_eq!(show(Some("nowhere")).0, 2);
    }

    #[test]
    fn a_description_gets_a_robot_file_that_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots");
        let name = shipped_robots().next().unwrap();
        let urdf = folder.path().join("mine.urdf");
        std::fs::copy(shipped.join(name).join(format!("{name}.urdf")), &urdf).unwrap();
        let new = || {
            let (urdf, packages) = (urdf.clone(), Vec::new());
            says(RobotCommand::New { urdf, out: None, semantics: None, packages, force: false })
        };
        assert_eq!(new().0, 0);
        let file = folder.path().join("robot.yaml");
        let model = description::load(&file, &[]).unwrap().model;
        let arms: Vec<_> = model.arms().map(|arm| (arm.name.as_str(), arm.joints.len())).collect();
        assert_eq!(arms, [("right_arm", 7), ("left_arm", 7)]);
        assert_eq!((model.limb("torso").len(), model.limb("right_hand").len()), (3, 2));
        let (status, said) = check(file.to_string_lossy());
        assert!(status == 0 && said.contains("no `wrench` for `left_arm`: cannot run: Tare"), "{said}");
        let (status, said) = new();
        assert!(status == 2 && said.contains("--force overwrites it"), "{said}");

        let macros = folder.path().join("mine.urdf.xacro");
        let text = "<robot name=\"r\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><xacro:include filename=\"a\"/></robot>";
        std::fs::write(&macros, text).unwrap();
        let (status, said) = check(macros.to_string_lossy());
        let command = format!("xacro {} > {}", macros.display(), urdf.display());
        assert!(status == 2 && said.contains(&command), "{said}");
    }
}
