//! Inference on small scenes and short histories, compared with results from geometry and counting.

use armarium_memoryx::{Consolidator, LongTermMemory, MemoryLimits, Policies, Policy, WorkingMemory};
use armarium_values::{Frame, Pose, Vector};
use nalgebra::{Isometry3, Vector3};

use super::*;

const DAY_NS: u64 = 86_400_000_000_000;

fn object(name: &str, class: &str, at: [f64; 3], time_ns: u64) -> Commit {
    let id = EntityId::new("ObjectInstances", "vision", name).unwrap();
    let position = Vector { frame: Frame::root(), components: at };
    Commit::new(id, time_ns, [("class", class.into()), ("position", position.into())])
}

fn sized(id: &str, size: [f64; 3], at: [f64; 3], yaw: f64) -> Commit {
    let pose = Isometry3::new(Vector3::from(at), Vector3::z() * yaw);
    let pose = Value::Pose(Pose::new(Frame::root(), &pose));
    Commit::new(id.parse().unwrap(), 1, [("class", "box".into()), ("pose", pose), ("size", size.into())])
}

fn memory() -> Arc<WorkingMemory> {
    let memory = crate::working_memory(Arc::new(|| 1));
    let prior = |name: &str, size: [f64; 3]| {
        let id = EntityId::new("ObjectClasses", "shop", name).unwrap();
        let color = Value::List(vec![Value::Int(1); 3]);
        Commit::new(id, 0, [("color", color), ("size", size.into()), ("recognition", "color".into())])
    };
    memory.commit_now(vec![prior("cup", [0.08, 0.08, 0.10]), prior("bowl", [0.3, 0.3, 0.2])]).unwrap();
    Arc::new(memory)
}

async fn relations(memory: &WorkingMemory) -> BTreeMap<String, f64> {
    conclude_once(memory, &SpatialRelations, 1).await.unwrap();
    let found = memory.segment(OBJECT_RELATIONS).await.unwrap();
    let text = |s: &Snapshot, name: &str| s.attribute(name).unwrap().as_str().unwrap().to_owned();
    let last = |address: String| address.rsplit('/').next().unwrap().to_owned();
    let said = |s: &Arc<Snapshot>| {
        let (subject, object) = (last(text(s, "subject")), last(text(s, "object")));
        (format!("{subject} {} {object}", text(s, "relation")), s.instance().unwrap().confidence)
    };
    found.iter().map(said).collect()
}

#[tokio::test]
async fn relations_follow_from_geometry() {
    let memory = memory();
    let table = sized("EnvironmentModels/map/table", [1.6, 0.8, 0.04], [0.0, 0.6, 0.78], 0.0);
    let above = |x: f64, y: f64| [x, y, 0.85];
    memory
        .commit_now(vec![
            table,
            object("cup", "cup", above(-0.3, 0.6), 1),
            object("cup_2", "cup", above(-0.15, 0.6), 1),
            object("bowl", "bowl", [0.5, 0.6, 0.90], 1),
            object("cup_3", "cup", [0.5, 0.6, 0.92], 1),
            object("cup_4", "cup", [0.0, 3.0, 0.85], 1),
        ])
        .unwrap();
    let said = relations(&memory).await;
    let words: Vec<&str> = said.keys().map(String::as_str).collect();
    assert_eq!(
        words,
        [
            "bowl on table",
            "cup left_of cup_2",
            "cup near cup_2",
            "cup on table",
            "cup_2 left_of bowl",
            "cup_2 on table",
            "cup_3 in bowl",
            "table near cup_3"
        ]
    );
    // A gap of at most 2 cm between two positions with 5 mm standard deviation each: 2 Phi(2.83) - 1.
    assert!((said["cup on table"] - 0.995_32).abs() < 1e-4, "{said:?}");
}

#[tokio::test]
async fn turned_boxes_reach_further_and_unsure_places_make_unsure_relations() {
    let memory = memory();
    // Along the diagonal a board of 1 m by 0.2 m reaches 0.42 m to each side.
    let board =
        sized("EnvironmentModels/map/board", [1.0, 0.2, 0.04], [0.0, 0.0, 0.78], std::f64::consts::FRAC_PI_4);
    memory.commit_now(vec![board, object("cup", "cup", [0.3, 0.3, 0.85], 1)]).unwrap();
    assert!(relations(&memory).await.contains_key("cup on board"));

    let mut unsure = object("cup", "cup", [0.3, 0.3, 0.85], 2);
    unsure.instances[0]
        .covariance
        .insert("position".into(), vec![0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4e-4]);
    memory.commit_now(vec![unsure.clone()]).unwrap();
    let said = relations(&memory).await;
    // Standard deviations of 20 mm and of 5 mm: (2 Phi(0.970) - 1) and not inside the board, Phi(-2.425).
    assert!((said["cup on board"] - 0.668 * (1.0 - 0.007_65)).abs() < 1e-3, "{said:?}");
    memory.commit_now(vec![unsure.with_confidence(0.7)]).unwrap();
    let said = relations(&memory).await;
    assert_eq!(said.keys().collect::<Vec<_>>(), ["board near cup"], "what is not sure any more is not said");
}

#[tokio::test]
async fn what_has_not_changed_is_not_written_again_and_says_what_it_rests_on() {
    let memory = memory();
    let cups = |time: u64| {
        vec![object("a", "cup", [0.0, 0.5, 1.0], time), object("b", "cup", [0.0, 0.6, 1.0], time)]
    };
    memory.commit_now(cups(1)).unwrap();
    let inference = SpatialRelations;
    let first = conclude_once(&*memory, &inference, 1).await.unwrap();
    assert_eq!(first, Round { concluded: 1, written: 1, removed: 0 });
    memory.commit_now(cups(2)).unwrap();
    let again = conclude_once(&*memory, &inference, 2).await.unwrap();
    assert_eq!(again, Round { concluded: 1, written: 0, removed: 0 });
    let found = memory.segment(OBJECT_RELATIONS).await.unwrap();
    assert_eq!(found[0].id.as_str(), "ObjectRelations/spatial_relations/vision-a-near-vision-b");
    assert_eq!(found[0].attribute("concluded_by"), Some(&Value::from("spatial_relations")));
    let because = found[0].attribute("because").unwrap().as_list().unwrap();
    assert_eq!(because[1].get("id"), Some(&Value::from("ObjectInstances/vision/b")));
    assert_eq!(because[1].get("version"), Some(&Value::Int(1)));

    memory.commit_now(vec![Commit::removal(cups(3)[0].id.clone(), 3)]).unwrap();
    let gone = conclude_once(&*memory, &inference, 3).await.unwrap();
    assert_eq!(gone, Round { concluded: 0, written: 0, removed: 1 });
}

#[tokio::test]
async fn usual_places_are_learned_from_all_earlier_days() {
    let folder = tempfile::tempdir().unwrap();
    let store = Arc::new(LongTermMemory::open(&folder.path().join("days.redb")).unwrap());
    let kept = Consolidator::new(Arc::clone(&store), Policies::all(Policy::Everything)).unwrap();
    // Working memory holds the last sighting only.
    let limits = MemoryLimits { history: 1, ..MemoryLimits::default() };
    let memory = crate::working_memory(Arc::new(|| 1)).with_limits(limits).with_backing(Arc::new(kept));
    let hour = 3_600_000_000_000;
    // Three days on the shelf, the fourth half in the sink; today on the floor.
    let shelf =
        |day: u64, i: u64| object("cup", "cup", [1.0 + 0.01 * i as f64, 0.5, 1.2], day * DAY_NS + i * hour);
    for day in 1..4 {
        memory.commit_now((0..4).map(|i| shelf(day, i)).collect()).unwrap();
    }
    let sink = |i: u64| object("cup", "cup", [-1.0, 0.5, 0.9], 4 * DAY_NS + i * hour);
    memory.commit_now(vec![shelf(4, 0), shelf(4, 1), sink(2), sink(3)]).unwrap();
    memory.commit_now(vec![object("cup", "cup", [0.0, 0.0, 0.0], 5 * DAY_NS + hour)]).unwrap();

    let now_ns = 5 * DAY_NS + 2 * hour;
    let round = conclude_once(&memory, &UsualPlaces, now_ns).await.unwrap();
    assert_eq!(round, Round { concluded: 2, written: 2, removed: 0 });
    let found = memory.segment(USUAL_PLACES).await.unwrap();
    let chances: Vec<f64> = found.iter().map(|s| s.instance().unwrap().confidence).collect();
    // 3.5 of 4 days, half a day, and half a place as the rest for a new one.
    assert!((chances[0] - 4.0 / 5.5).abs() < 1e-12 && (chances[1] - 1.0 / 5.5).abs() < 1e-12, "{chances:?}");
    let Some(Value::Vector(place)) = found[0].attribute("position") else { panic!("no place") };
    assert!(armarium_memoryx::distance(&place.components, &[1.0132, 0.5, 1.2]) < 2e-3, "{place:?}");
    assert_eq!(found[0].attribute("days"), Some(&Value::Int(4)));
    assert_eq!(found[0].attribute("sightings"), Some(&Value::Int(14)));
    assert_eq!(found[1].attribute("last_seen_ns"), Some(&Value::Int((4 * DAY_NS + 3 * hour) as i64)));

    // A carried object is in no place.
    let mut carried = shelf(6, 0);
    carried.instances[0].attributes = carried.instances[0].attributes.with("motion_model", "hand".into());
    memory.commit_now(vec![carried]).unwrap();
    let later = conclude_once(&memory, &UsualPlaces, 8 * DAY_NS).await.unwrap();
    assert_eq!(later, Round { concluded: 3, written: 3, removed: 0 }, "the floor of day 5 counts now");
}

#[tokio::test(start_paused = true)]
async fn an_attached_inference_concludes_when_something_changes() {
    let memory = memory();
    let inference: Arc<dyn Inference> = Arc::new(SpatialRelations);
    let attached = RunningInference::start(Arc::<WorkingMemory>::clone(&memory), inference, Arc::new(|| 5));
    let rounds = async |count: u64| {
        while attached.rounds() < count {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    rounds(1).await;
    memory
        .commit_now(vec![object("a", "cup", [0.0, 0.5, 1.0], 5), object("b", "cup", [0.0, 0.6, 1.0], 5)])
        .unwrap();
    rounds(2).await;
    assert_eq!(memory.segment(OBJECT_RELATIONS).await.unwrap().len(), 1);
    // Its own conclusions do not start a round.
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!(attached.rounds(), 2);
}

#[test]
fn names_of_names_are_names() {
    assert_eq!(joined(&["a", "on", "b"]), "a-on-b");
    let odd = joined(&["a/b", "é"]);
    assert!(odd.starts_with("a_b-é-") && check_name(&odd).is_ok(), "{odd}");
    let long = "ö".repeat(150);
    let (first, second) = (joined(&[&long, "x"]), joined(&[&long, "y"]));
    assert!(first != second && check_name(&first).is_ok() && check_name(&second).is_ok());
}
