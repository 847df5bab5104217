//! The coach's section of a world file.

use super::super::tree::{Node, Raw};
use super::super::{
    CoachSpec, CoachingAction, CoachingStep, Demonstration, Gesture, Push, Shape, Show, Swipe,
};
use super::MAX_LIST;
use super::values::{Reader, Section, Unit};

impl Reader<'_> {
    pub(super) fn coach(&mut self, node: &Node, coach: &mut CoachSpec) {
        let Some(s) = self.section(node, &["tool", "demonstration", "coaching", "ends"]) else { return };
        if let Some(t) = s.get("tool").and_then(|n| self.section(n, &["color"])) {
            self.color(t.get("color"), &mut coach.tool.color);
        }
        if let Some(n) = s.get("demonstration") {
            coach.demonstration = self.demonstration(n);
        }
        if let Some(items) = s.get("coaching").and_then(|n| self.list(n, MAX_LIST)) {
            coach.coaching = items.iter().filter_map(|n| self.step(n)).collect();
        }
        self.number(s.get("ends"), &mut coach.ends, Unit::Second, 0.0..=3600.0);
    }

    fn demonstration(&mut self, node: &Node) -> Option<Demonstration> {
        match &node.value {
            Raw::Null => return None,
            Raw::Text(t) if t == "none" => return None,
            _ => {}
        }
        let mut d = Demonstration::default();
        let keys = ["shape", "size", "frequency", "swipe", "height", "periods", "jitter"];
        let s = self.section(node, &keys)?;
        let shapes = [("ellipse", Shape::Ellipse), ("eight", Shape::Eight), ("line", Shape::Line)];
        self.choice(s.get("shape"), &mut d.shape, &shapes);
        self.vector(s.get("size"), &mut d.size, Unit::Metre, 0.0..=1.0);
        self.number(s.get("frequency"), &mut d.frequency, Unit::Hertz, 0.05..=5.0);
        self.number(s.get("height"), &mut d.height, Unit::Metre, 0.05..=0.8);
        self.whole(s.get("periods"), &mut d.periods, Unit::None, 0..=1000);
        self.number(s.get("jitter"), &mut d.jitter, Unit::None, 0.0..=0.3);
        if let Some(n) = s.get("swipe") {
            self.swipe(n, &mut d.swipe);
        }
        Some(d)
    }

    fn swipe(&mut self, node: &Node, swipe: &mut Swipe) {
        let Some(s) = self.section(node, &["from", "to"]) else { return };
        self.vector(s.get("from"), &mut swipe.from, Unit::Metre, -3.0..=3.0);
        self.vector(s.get("to"), &mut swipe.to, Unit::Metre, -3.0..=3.0);
        let [dx, dy] = [swipe.to[0] - swipe.from[0], swipe.to[1] - swipe.from[1]];
        if dx.hypot(dy) < 0.02 {
            let message = "the swipe goes nowhere".into();
            self.find(
                node.referenced,
                "world::value",
                message,
                "`from` and `to` differ by 2 cm or more".into(),
            );
        }
    }

    fn step(&mut self, node: &Node) -> Option<CoachingStep> {
        let keys = ["at", "push", "gesture", "phase", "offset", "for", "direction"];
        let s = self.section(node, &keys)?;
        let mut at = 0.0;
        self.number(s.get("at"), &mut at, Unit::Second, 0.0..=3600.0);
        let action = match (s.get("push"), s.get("gesture")) {
            (Some(push), None) => {
                for (key, _) in s.entries.iter().filter(|(k, _)| !matches!(k.value.as_str(), "at" | "push")) {
                    let message = format!("`{}` belongs to a gesture, not to a push", key.value);
                    self.find(key.referenced, "world::unknown_key", message, String::new());
                }
                self.push(push)
            }
            (None, Some(_)) => self.show(node, &s),
            _ => {
                let message = "a coaching step has either `push` or `gesture`".into();
                self.find(node.referenced, "world::value", message, String::new());
                return None;
            }
        };
        action.map(|action| CoachingStep { at, action })
    }

    fn push(&mut self, node: &Node) -> Option<CoachingAction> {
        let mut push = Push::default();
        let s = self.section(node, &["phase", "arc", "force", "cycles"])?;
        self.number(s.get("phase"), &mut push.phase, Unit::None, 0.0..=1.0);
        self.number(s.get("arc"), &mut push.arc, Unit::None, 0.01..=0.5);
        self.vector(s.get("force"), &mut push.force, Unit::Newton, -500.0..=500.0);
        self.whole(s.get("cycles"), &mut push.cycles, Unit::None, 1..=1000);
        Some(CoachingAction::Push { push })
    }

    fn show(&mut self, node: &Node, s: &Section<'_>) -> Option<CoachingAction> {
        let mut show = Show {
            gesture: Gesture::Fist,
            phase: 0.0,
            offset: [0.0, 0.0, 0.0],
            duration: 10.0,
            direction: None,
        };
        let gestures = [
            ("fist", Gesture::Fist),
            ("point_one", Gesture::PointOne),
            ("point_two", Gesture::PointTwo),
            ("open_hand", Gesture::OpenHand),
        ];
        self.choice(s.get("gesture"), &mut show.gesture, &gestures);
        self.number(s.get("phase"), &mut show.phase, Unit::None, 0.0..=1.0);
        self.number(s.get("for"), &mut show.duration, Unit::Second, 0.1..=600.0);
        match s.get("offset") {
            None => {
                let message = "a gesture needs its `offset` from the path".into();
                self.find(node.referenced, "world::missing", message, "offset: [0.0, 0.12, 0.0]".into());
            }
            n => self.vector(n, &mut show.offset, Unit::Metre, -1.0..=1.0),
        }
        match (show.gesture, s.get("direction")) {
            (Gesture::PointOne, Some(n)) => {
                let mut direction = [0.0; 3];
                self.vector(Some(n), &mut direction, Unit::Metre, -1.0..=1.0);
                if direction == [0.0; 3] {
                    let message = "the direction has no length".into();
                    self.find(n.referenced, "world::value", message, String::new());
                }
                show.direction = Some(direction);
            }
            (Gesture::PointOne, None) => {
                let message = "`point_one` needs a `direction`".into();
                self.find(node.referenced, "world::missing", message, "direction: [0.0, 0.04, 0.0]".into());
            }
            (_, Some(n)) => {
                let message = "only `point_one` has a direction".into();
                self.find(n.referenced, "world::unknown_key", message, String::new());
            }
            (_, None) => {}
        }
        Some(CoachingAction::Show(show))
    }
}
