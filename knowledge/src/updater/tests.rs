//! The updater compared with closed forms: matching, fusion, prediction and enrichment.

use armarium_memoryx::WorkingMemory;
use armarium_values::Pose;
use nalgebra::{Isometry3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::prior::{ObjectClass, PriorKnowledge};

const VARIANCE: f64 = 1e-4;

fn memory() -> Arc<WorkingMemory> {
    let memory = crate::working_memory(Arc::new(|| 0));
    let mut prior = PriorKnowledge::new();
    prior.add(ObjectClass::new("cup", [200, 0, 0], [0.08, 0.08, 0.1]).with_mass(0.2)).unwrap();
    prior.put_into(&memory).unwrap();
    Arc::new(memory)
}

fn updater(memory: &Arc<WorkingMemory>) -> Updater {
    Updater::new(Arc::<WorkingMemory>::clone(memory), "vision").unwrap()
}

fn at(x: f64, y: f64) -> ObservedPlace {
    ObservedPlace::new(&Frame::root(), &Vector3::new(x, y, 1.0), &(Matrix3::identity() * VARIANCE))
}

fn cup(seconds: f64, x: f64, y: f64) -> Observation {
    Observation::new(OBJECT_INSTANCES, "cup", (seconds * 1e9) as u64).at(at(x, y)).with_confidence(0.6)
}

/// The newest snapshot of an object.
fn seen(memory: &WorkingMemory, name: &str) -> Arc<Snapshot> {
    memory.latest_now(&EntityId::new(OBJECT_INSTANCES, "vision", name).unwrap()).unwrap()
}

fn names(found: &[(EntityId, u64)]) -> Vec<(&str, u64)> {
    found.iter().map(|(id, version)| (id.entity(), *version)).collect()
}

#[tokio::test(start_paused = true)]
async fn observations_find_their_entities_whatever_their_order() {
    let memory = memory();
    let updater = updater(&memory);
    let first = updater.update(&[cup(0.0, 0.0, 0.0), cup(0.0, 0.5, 0.0)]).await.unwrap();
    assert_eq!(names(&first), [("cup", 1), ("cup_2", 1)]);
    let second =
        updater.update(&[cup(0.1, 0.51, 0.0), cup(0.1, 0.01, 0.0), cup(0.1, 2.0, 2.0)]).await.unwrap();
    assert_eq!(names(&second), [("cup_2", 2), ("cup", 2), ("cup_3", 1)]);
    // Between two cups: the assignment gives each observation the cup that makes both fit.
    let third = updater.update(&[cup(0.2, 0.02, 0.0), cup(0.2, 0.03, 0.0)]).await.unwrap();
    assert_eq!(names(&third), [("cup", 3), ("cup_4", 1)]);
}

#[tokio::test(start_paused = true)]
async fn a_place_is_fused_and_a_new_entity_enriched() {
    let memory = memory();
    let updater = updater(&memory).with_settings(Settings { drift: 0.0, ..Settings::default() });
    for x in [0.10, 0.12, 0.11, 0.09] {
        updater.update(&[cup(0.0, x, 0.0)]).await.unwrap();
    }
    let found = seen(&memory, "cup");
    let Some(Value::Vector(position)) = found.attribute("position") else { panic!("no position") };
    // Four observations of equal weight: their mean, a quarter of the variance.
    assert!((position.components[0] - 0.105).abs() < 1e-12);
    let covariance = &found.instance().unwrap().covariance["position"];
    assert!((covariance[0] - VARIANCE / 4.0).abs() < 1e-12 && covariance[1].abs() < 1e-15);
    assert!((found.instance().unwrap().confidence - (1.0 - 0.4_f64.powi(4))).abs() < 1e-12);
    assert_eq!(found.attribute("mass"), Some(&Value::Float(0.2)));
    assert_eq!(found.attribute("prior").and_then(Value::as_reference).unwrap().id, "ObjectClasses/prior/cup");
}

#[tokio::test(start_paused = true)]
async fn noise_becomes_as_small_as_it_can() {
    use rand::RngExt;
    let memory = memory();
    let updater = updater(&memory).with_settings(Settings { drift: 0.0, gate: 40.0, ..Settings::default() });
    let mut random = ChaCha8Rng::seed_from_u64(3);
    // The sum of twelve uniform numbers, less six, has variance one.
    let mut noise = || (0..12).map(|_| random.random_range(0.0..1.0)).sum::<f64>() - 6.0;
    for i in 0..100 {
        let at = (0.3 + noise() * VARIANCE.sqrt(), noise() * VARIANCE.sqrt());
        updater.update(&[cup(f64::from(i) * 0.03, at.0, at.1)]).await.unwrap();
    }
    let found = seen(&memory, "cup");
    let (_, position) = armarium_memoryx::place_of(&found).unwrap();
    // A hundredth of the variance: 1 mm, within three of it.
    assert!((position[0] - 0.3).abs() < 3e-3 && position[1].abs() < 3e-3, "{position:?}");
    assert_eq!(memory.query_now(&Query::latest(Pattern::segment(OBJECT_INSTANCES))).unwrap().len(), 1);
}

struct Hand;

impl Carriers for Hand {
    fn hand(&self, name: &str, at_ns: u64) -> Option<Pose> {
        let position = [at_ns as f64 * 1e-9, 0.0, 1.0];
        // A quarter turn about z.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = Pose { frame: Frame::root(), position, orientation: [0.0, 0.0, half, half] };
        (name == "right").then_some(pose)
    }
}

#[tokio::test(start_paused = true)]
async fn what_is_carried_moves_with_its_carrier() {
    let memory = memory();
    let updater = updater(&memory).with_carriers(Arc::new(Hand));
    updater.update(&[cup(0.0, 0.0, 0.0)]).await.unwrap();
    let id: EntityId = "ObjectInstances/vision/cup".parse().unwrap();
    let held = MotionModel::Hand { name: "right".into(), offset: Isometry3::translation(0.1, 0.0, 0.0) };
    let before = memory.latest_now(&id).unwrap();
    let mut attributes = before.instance().unwrap().attributes.to_map();
    attributes.extend(held.attributes());
    let instance = Instance { attributes: attributes.into(), ..before.instance().unwrap().clone() };
    memory.commit_now(vec![Commit::of(id.clone(), 0, vec![instance])]).unwrap();
    let now = memory.latest_now(&id).unwrap();
    let settings = Settings::default();
    let (frame, place) = predict(&now, 2_000_000_000, &[], &Hand, &settings).unwrap();
    assert_eq!(frame, Frame::root());
    // The hand is at x = 2 and turned: the offset along its x points along y.
    assert!((place.mean() - Vector3::new(2.0, 0.1, 1.0)).norm() < 1e-12, "{place:?}");
    assert!((place.covariance()[(0, 0)] - VARIANCE - 2.0 * settings.carried_drift).abs() < 1e-12);
    // A cup seen where the hand has carried it is the same cup; a plate on it moves along.
    let seen = updater.update(&[cup(2.0, 2.0, 0.11)]).await.unwrap();
    assert_eq!(names(&seen), [("cup", 3)]);
    let on = MotionModel::Object { id: id.to_string(), offset: Isometry3::translation(0.0, 0.0, 0.1) };
    let mut attributes: BTreeMap<String, Value> = on.attributes().into_iter().collect();
    attributes.insert("class".into(), "plate".into());
    attributes.insert("position".into(), Vector { frame: Frame::root(), components: [9.0; 3] }.into());
    let plate: EntityId = "ObjectInstances/vision/plate".parse().unwrap();
    memory.commit_now(vec![Commit::new(plate.clone(), 0, attributes)]).unwrap();
    let held = memory.query_now(&Query::latest(Pattern::segment(OBJECT_INSTANCES))).unwrap();
    let plate = memory.latest_now(&plate).unwrap();
    let (_, place) = predict(&plate, 3_000_000_000, &held, &Hand, &settings).unwrap();
    assert!((place.mean() - Vector3::new(3.0, 0.1, 1.1)).norm() < 1e-12, "{place:?}");
}

#[tokio::test(start_paused = true)]
async fn what_cannot_be_an_observation_is_refused_whole() {
    let memory = memory();
    let updater = updater(&memory);
    let mut bad = cup(0.0, 0.0, 0.0);
    bad.place.as_mut().unwrap().covariance = [0.0; 9];
    let refused = updater.update(&[cup(0.0, 1.0, 0.0), bad]).await;
    assert!(matches!(refused, Err(MemoryError::Schema { .. })), "{refused:?}");
    assert_eq!(memory.query_now(&Query::latest(Pattern::segment(OBJECT_INSTANCES))).unwrap().len(), 0);
    assert!(Updater::new(memory, "a/b").is_err());
}

#[tokio::test(start_paused = true)]
async fn a_hand_is_where_it_was_seen_last_and_is_still_the_hand_after_it_was_gone() {
    let memory = memory();
    let updater = updater(&memory);
    let hand = |seconds: f64, x: f64| Observation {
        segment: "HumanHands".into(),
        class: "hand".into(),
        ..cup(seconds, x, 0.0).with("gesture", "fist")
    };
    let none = Observation::new("HumanHands", "hand", 200_000_000).with("gesture", "none");
    for (seen, x) in
        [(hand(0.0, 0.1), Some(0.1)), (hand(0.1, 0.3), Some(0.3)), (none, None), (hand(0.3, 0.9), Some(0.9))]
    {
        let found = updater.update(&[seen]).await.unwrap();
        assert_eq!(found[0].0.as_str(), "HumanHands/vision/hand");
        let hand = memory.latest_now(&found[0].0).unwrap();
        let place = hand.attribute("position").and_then(Value::as_vector3);
        assert_eq!(place.map(|place| place[0]), x);
    }
    let two = updater.update(&[hand(0.4, 0.95), hand(0.4, -0.9)]).await.unwrap();
    assert_eq!(names(&two), [("hand", 5), ("hand_2", 1)]);
    // Without hands, both are gone; the next one is the hand again, wherever it is and in whatever frame.
    let gone = Observation::new("HumanHands", "hand", 500_000_000).with("gesture", "none");
    assert_eq!(names(&updater.update(&[gone]).await.unwrap()), [("hand", 6), ("hand_2", 2)]);
    assert_eq!(names(&updater.update(&[hand(0.6, 5.0)]).await.unwrap()), [("hand", 7)]);
    let mut elsewhere = hand(0.7, 0.0);
    elsewhere.place.as_mut().unwrap().position.frame = Frame::from("camera");
    let both = [elsewhere, Observation::new("HumanHands", "hand", 700_000_000)];
    let both = updater.update(&both).await.unwrap();
    assert_eq!(both.len(), 2, "{both:?}");
}

#[tokio::test(start_paused = true)]
async fn what_is_observed_without_a_place_is_where_it_was_and_no_surer() {
    let memory = memory();
    let updater = updater(&memory);
    let first = updater.update(&[cup(0.0, 0.1, 0.0)]).await.unwrap();
    let told = Observation::new(OBJECT_INSTANCES, "cup", 100_000_000).with("full", true);
    assert_eq!(names(&updater.update(&[told]).await.unwrap()), [("cup", 2)]);
    let cup = memory.latest_now(&first[0].0).unwrap();
    assert_eq!(cup.attribute("position").and_then(Value::as_vector3), Some([0.1, 0.0, 1.0]));
    assert_eq!((cup.attribute("full"), cup.instance().unwrap().confidence), (Some(&Value::Bool(true)), 0.6));
    assert!(updater.update(&[]).await.unwrap().is_empty());
}

/// A search for cups that sees everything with `x` < 0.5; something is before what has `x` > 0.4.
fn look(seconds: f64) -> Search {
    let classes = vec![(OBJECT_INSTANCES.to_owned(), "cup".to_owned())];
    Search::new((seconds * 1e9) as u64, classes, &Frame::root(), |place| match place.x {
        ..0.4 => Shown::Open,
        ..0.5 => Shown::Hidden,
        _ => Shown::Outside,
    })
}

#[tokio::test(start_paused = true)]
async fn what_should_be_seen_and_is_not_is_doubted_and_forgotten() {
    let memory = memory();
    let updater = updater(&memory);
    for at in [0.0, 0.1, 0.2] {
        updater.update(&[cup(at, 0.0, 0.0), cup(at, 0.3, 0.0), cup(at, 0.8, 0.0)]).await.unwrap();
    }
    let confidence = |name: &str| {
        let id = EntityId::new(OBJECT_INSTANCES, "vision", name).unwrap();
        memory.latest_now(&id).ok().map(|cup| cup.instance().unwrap().confidence)
    };
    let before = confidence("cup_2").unwrap();
    // The first one is carried by somebody: his hand hides it.
    let held = MotionModel::Hand { name: "bob/right_hand".into(), offset: Isometry3::identity() };
    let first = seen(&memory, "cup");
    let mut attributes = first.instance().unwrap().attributes.to_map();
    attributes.extend(held.attributes());
    memory.commit_now(vec![Commit::new(first.id.clone(), first.referenced_ns, attributes)]).unwrap();
    for frame in 0..3 {
        updater.update_from(&[], Some(&look(0.3 + f64::from(frame) * 0.07))).await.unwrap();
    }
    assert!(confidence("cup_2").unwrap() < before);
    assert_eq!(seen(&memory, "cup_2").referenced_ns, 200_000_000);
    for _ in 0..12 {
        updater.update_from(&[], Some(&look(0.6))).await.unwrap();
    }
    assert_eq!(confidence("cup_2"), None, "forgotten");
    assert_eq!(confidence("cup_3"), Some(before), "out of view");
    assert!(confidence("cup").is_some(), "in a hand");
    assert_eq!(confidence("cup_4"), None);
}

#[tokio::test(start_paused = true)]
async fn what_is_not_where_it_was_but_elsewhere_has_moved() {
    let memory = memory();
    let updater = updater(&memory);
    let first = updater.update(&[cup(0.0, 0.0, 0.0), cup(0.0, 0.3, 0.0)]).await.unwrap();
    assert_eq!(names(&first), [("cup", 1), ("cup_2", 1)]);
    let both = [cup(0.1, 0.3, 0.0), cup(0.1, -0.2, 0.1)];
    let found = updater.update_from(&both, Some(&look(0.1))).await.unwrap();
    assert_eq!(names(&found), [("cup_2", 2), ("cup", 2)]);
    let moved = memory.latest_now(&first[0].0).unwrap();
    assert_eq!(moved.attribute("position").and_then(Value::as_vector3), Some([-0.2, 0.1, 1.0]));
    assert_eq!(moved.instance().unwrap().confidence, 0.6);
    // A hand hides it, and nearby is one that nobody knew; far away, it would be another one.
    let hidden = updater.update(&[cup(0.2, 0.45, 0.0)]).await.unwrap();
    assert_eq!(names(&hidden), [("cup_3", 1)]);
    let near = [cup(0.3, 0.3, 0.0), cup(0.3, -0.2, 0.1), cup(0.3, 0.1, 0.2)];
    let found = updater.update_from(&near, Some(&look(0.3))).await.unwrap();
    assert_eq!(names(&found), [("cup_2", 3), ("cup", 3), ("cup_3", 2)]);
    // Where nobody has looked, nothing is missed: it is another one.
    assert_eq!(names(&updater.update(&[cup(0.2, 0.0, 0.4)]).await.unwrap()), [("cup_4", 1)]);
}

#[tokio::test(start_paused = true)]
async fn what_others_have_fused_is_no_new_evidence() {
    let memory = memory();
    let updater = updater(&memory).with_settings(Settings { drift: 0.0, ..Settings::default() });
    updater.update(&[cup(0.0, 0.1, 0.0)]).await.unwrap();
    for _ in 0..10 {
        updater.adopt(&[cup(0.0, 0.11, 0.0)]).await.unwrap();
    }
    let found = seen(&memory, "cup");
    let instance = found.instance().unwrap();
    let covariance = &instance.covariance["position"];
    assert!((covariance[0] - VARIANCE).abs() < 1e-9, "no surer: {covariance:?}");
    assert_eq!(instance.confidence, 0.6);
}

#[tokio::test(start_paused = true)]
async fn who_follows_entities_himself_names_them_and_says_when_they_are_gone() {
    let memory = memory();
    let updater = updater(&memory);
    let named = |name: &str, x: f64, confidence: f64| {
        let seen = Observation::new("EnvironmentModels", "table", 1).at(at(x, 0.0));
        seen.named(name).with_confidence(confidence)
    };
    let first = updater.update(&[named("table", 0.0, 0.9), named("table_2", 2.0, 0.9)]).await.unwrap();
    assert_eq!(names(&first), [("table", 1), ("table_2", 1)]);
    // Each keeps its name, wherever it is; what nobody knows cannot go.
    let both = [named("table", 2.0, 0.8), named("table_2", 0.0, 0.0), named("table_3", 0.0, 0.0)];
    assert_eq!(names(&updater.update(&both).await.unwrap()), [("table", 2), ("table_2", 2)]);
    let there = memory.latest_now(&first[0].0).unwrap();
    assert_eq!(there.attribute("position").and_then(Value::as_vector3), Some([2.0, 0.0, 1.0]));
    assert!(memory.latest_now(&first[1].0).is_err());
}
