//! Draws an attribute over time.

use std::io::Write;

use armarium_memoryx::{Pattern, Query, Snapshot};
use armarium_values::Value;
use armarium_viewer::report::{Curve, Panel, PanelRow, picture};

use super::reach::{OpenedMemory, id, unusable};
use super::{CommandFailure, PlotArgs};

/// Height of the picture, px of 1000.
const HEIGHT: f64 = 360.0;

/// Draws all versions that still exist, long-term memory included, against the time that they describe.
pub(super) async fn plot(
    reached: &OpenedMemory,
    args: &PlotArgs,
    out: &mut dyn Write,
) -> Result<(), CommandFailure> {
    let (entity, attribute) = args.what.rsplit_once('.').ok_or_else(|| {
        CommandFailure::Argument(format!("`{}` is not SEGMENT/PROVIDER/ENTITY.ATTRIBUTE", args.what))
    })?;
    let id = id(entity)?;
    let mut found: Vec<(u64, Vec<f64>)> = Vec::new();
    let read = |snapshot: &Snapshot| {
        found.extend(
            snapshot.attribute(attribute).and_then(parts).map(|parts| (snapshot.referenced_ns, parts)),
        );
        Ok(())
    };
    reached.each(Query::history(Pattern::entity(&id)).with_long_term(), read).await?;
    found.sort_by_key(|(time, _)| *time);
    let Some((first, parts)) = found.first() else {
        return Err(CommandFailure::Refused(format!(
            "no version of `{id}` has a number, vector or pose `{attribute}`"
        )));
    };
    let seconds = |time: u64| (time - first) as f64 * 1e-9;
    let curve = |(part, name): (usize, &str)| {
        let points = found.iter().filter_map(|(time, parts)| Some([seconds(*time), *parts.get(part)?]));
        Curve::new(name, points.collect())
    };
    let names: &[&str] = if parts.len() == 1 { &[attribute] } else { &["x", "y", "z"] };
    let panel = Panel {
        x_label: "time since the first version, s".into(),
        y_label: attribute.to_owned(),
        curves: names.iter().copied().enumerate().map(curve).collect(),
        ..Panel::default()
    };
    let svg = picture(&args.what, &[PanelRow { height: HEIGHT, panels: vec![panel] }]);
    match &args.output {
        Some(path) => std::fs::write(path, svg).map_err(|error| unusable(path, &error)),
        None => Ok(out.write_all(svg.as_bytes())?),
    }
}

/// The numbers that are drawn of a value.
fn parts(value: &Value) -> Option<Vec<f64>> {
    match value {
        Value::Vector(vector) => Some(vector.components.to_vec()),
        Value::Pose(pose) => Some(pose.position.to_vec()),
        other => other.as_f64().map(|number| vec![number]),
    }
}
