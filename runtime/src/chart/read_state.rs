//! From the YAML tree to the model: states with their transitions and watches.

use std::sync::Arc;

use armarium_source::yaml::{Entries, Named, Node, Yaml};
use armarium_source::{Edit, Remedy, Span, code};

use super::model::{Retry, WrittenEntry, WrittenKind, WrittenState, WrittenTransition, WrittenWatch};
use super::read::{ChartReader, MAX_LEVELS, get, only_known};
use super::{foreign, forms};

/// Where a failure leads, or else the first transition.
fn only_target(entries: &Entries) -> Option<String> {
    let transitions = match get(entries, "transitions").map(|node| &node.value) {
        Some(Yaml::Map(transitions)) => transitions,
        _ => return None,
    };
    let target =
        |node: &Node| if let Yaml::String(target) = &node.value { Some(target.clone()) } else { None };
    get(transitions, "failure")
        .and_then(target)
        .or_else(|| transitions.iter().find_map(|(_, node)| target(node)))
}

impl ChartReader<'_> {
    pub(super) fn state(
        &mut self,
        name: Named,
        span: Span,
        entries: &Entries,
        level: usize,
        root: bool,
    ) -> Option<WrittenState> {
        if level > MAX_LEVELS {
            self.error(code::LIMIT, name.span, format!("states are nested deeper than {MAX_LEVELS} levels"));
            return None;
        }
        if !root {
            self.name(&name);
            self.known(entries, forms::STATE, "a state");
        }
        let kind = self.kind(&name, span, entries, level, root);
        let unbreakable = self.flag(entries, "unbreakable");
        let with = get(entries, "with").map_or_else(Vec::new, |n| self.entries(n).to_vec());
        // Where a key is misspelt, nobody knows yet what takes the inputs.
        let misspelt = matches!(kind, WrittenKind::Atomic) && !only_known(entries, forms::STATE);
        let description = self.words(entries, "description");
        Some(WrittenState {
            description,
            kind,
            with: if misspelt { Vec::new() } else { with },
            enter: self.actions(get(entries, "enter")),
            exit: self.actions(get(entries, "exit")),
            watch: self.watches(entries),
            after: self.after(entries),
            always: get(entries, "always").map_or_else(Vec::new, |n| self.transition_list(n, None)),
            transitions: self.transitions(entries),
            retry: self.retry(entries),
            limits: self.limits(entries),
            unbreakable,
            name,
        })
    }

    fn flag(&mut self, entries: &Entries, key: &str) -> bool {
        match get(entries, key).map(|n| (&n.value, n.span)) {
            None | Some((Yaml::Bool(false), _)) => false,
            Some((Yaml::Bool(true), _)) => true,
            Some((_, at)) => {
                self.error(code::FORM, at, "`true` or `false` is needed here");
                false
            }
        }
    }

    fn kind(&mut self, name: &Named, span: Span, entries: &Entries, level: usize, root: bool) -> WrittenKind {
        const KINDS: [&str; 7] = ["skill", "statechart", "remote", "states", "parallel", "final", "history"];
        let given: Vec<&(Named, Node)> = entries
            .iter()
            .filter(|(k, _)| KINDS.contains(&k.text.as_str()) && !(root && k.text == "statechart"))
            .collect();
        let flag = |key: &Named, node: &Node| key.text == "parallel" && matches!(node.value, Yaml::Bool(_));
        if let Some((_, node)) = given.iter().find(|(key, node)| flag(key, node)) {
            return self.parallel_as_a_flag(node, entries, level);
        }
        if let [(first, _), (second, _), ..] = given.as_slice() {
            let message = format!("a state is one thing: it has both `{}` and `{}`", first.text, second.text);
            self.error(code::KIND, second.span, message);
            self.findings.remedy(Remedy::Remove(second.span));
        }
        let form = if root { forms::CHART } else { forms::STATE };
        if given.len() < 2 && only_known(entries, form) {
            self.unused(given.first().map(|(key, _)| key.text.as_str()), entries);
        }
        let Some((key, node)) = given.first() else { return WrittenKind::Atomic };
        if key.text == "final" {
            let ways = ["transitions", "after", "always", "watch", "retry"];
            for (way, _) in entries.iter().filter(|(key, _)| ways.contains(&key.text.as_str())) {
                let message =
                    format!("a final state ends what is around it: its `{}` is never used", way.text);
                let help = "put it at the state around it, which gets the outcome";
                self.error_help(code::KIND, way.span, &message, help);
                self.findings.remedy(Remedy::Remove(way.span));
            }
        }
        match key.text.as_str() {
            "states" => {
                let states = self.states(node, level);
                let Some(initial) = get(entries, "initial") else {
                    if !only_known(entries, form) {
                        return WrittenKind::Composite { initial: WrittenEntry::default(), states };
                    }
                    let help = match states.first() {
                        Some(first) => {
                            format!("add `initial: {}`, the state that it is entered at", first.name.text)
                        }
                        None => "add `initial: Name`, the state that it is entered at".to_owned(),
                    };
                    self.error_help(code::MISSING_KEY, key.span, "`states` needs `initial`", &help);
                    if let Some(first) = states.first() {
                        // The chart's own name is no key: its states stand at the outermost level.
                        let (owner, value) = ((!root).then_some(name.span), first.name.text.clone());
                        let key = "initial".to_owned();
                        self.findings.remedy(Remedy::Add { owner, sections: Vec::new(), key, value });
                    }
                    return WrittenKind::Composite { initial: WrittenEntry::default(), states };
                };
                WrittenKind::Composite { initial: self.entry(initial), states }
            }
            "parallel" => WrittenKind::Parallel(self.states(node, level)),
            "final" if !matches!(node.value, Yaml::String(_)) => {
                self.form_of_final(node);
                WrittenKind::Final(Named { span: node.span, text: "success".into() })
            }
            "history" => {
                let default = get(entries, "default").map(|n| self.entry(n));
                let form = self.text(node);
                match form.as_ref().map(|f| f.text.as_str()) {
                    Some("shallow" | "deep") | None => {}
                    Some(_) => self.error(code::FORM, node.span, "history is `shallow` or `deep`"),
                }
                if default.is_none() {
                    self.error(code::MISSING_KEY, span, "history needs `default: Target`");
                }
                WrittenKind::History {
                    deep: form.is_some_and(|f| f.text == "deep"),
                    default: default.unwrap_or_default(),
                }
            }
            key => match (key, self.text(node)) {
                ("skill", Some(name)) => WrittenKind::Skill(name),
                ("statechart", Some(name)) => WrittenKind::Chart(name),
                ("remote", Some(name)) => WrittenKind::Remote(name),
                ("final", Some(outcome)) => WrittenKind::Final(outcome),
                _ => WrittenKind::Atomic,
            },
        }
    }

    /// Keys that a state of this kind never uses. A final state's own are another finding.
    fn unused(&mut self, kind: Option<&str>, entries: &Entries) {
        let of = |key: &str| match key {
            "initial" if kind != Some("states") => Some("`initial` belongs to `states`"),
            "default" if kind != Some("history") => Some("`default` belongs to `history`"),
            "retry" if kind.is_none() => {
                Some("only what can fail is tried again: a skill, a chart, inner states")
            }
            "with" | "enter" | "exit" | "watch" | "after" | "always" | "transitions" | "retry" | "limits"
            | "unbreakable"
                if kind == Some("history") =>
            {
                Some("a history only stands for other states, which have their own")
            }
            _ => None,
        };
        for (key, _) in entries {
            if let Some(help) = of(&key.text) {
                let message = format!("`{}` is never used here", key.text);
                self.error_help(code::KIND, key.span, &message, help);
                self.findings.remedy(Remedy::Remove(key.span));
            }
        }
    }

    /// `parallel: true` beside `states`: other languages have a flag.
    fn parallel_as_a_flag(&mut self, flag: &Node, entries: &Entries, level: usize) -> WrittenKind {
        let help = "write `parallel:` for `states:`; all regions are entered, so that there is no `initial`";
        self.error_help(code::FORM, flag.span, "the regions stand under `parallel`", help);
        let key = |name: &str| entries.iter().find(|(key, _)| key.text == name);
        let Some((states, regions)) = key("states") else { return WrittenKind::Atomic };
        let source = Arc::clone(&self.findings.source);
        let removed = ["parallel", "initial"].into_iter().filter_map(key);
        let mut edits: Vec<Edit> =
            removed.flat_map(|(key, _)| Remedy::Remove(key.span).edits(&source)).collect();
        edits.push(Edit { span: states.span, text: "parallel".into() });
        edits.sort_by_key(|edit| edit.span.start);
        self.findings.remedy(Remedy::Replace(edits));
        WrittenKind::Parallel(self.states(regions, level))
    }

    /// `final: true` and the like: other languages have a flag, and the outcome elsewhere.
    fn form_of_final(&mut self, node: &Node) {
        let outcome = if matches!(node.value, Yaml::Bool(false)) { "failure" } else { "success" };
        let help = format!("write `final: {outcome}`");
        self.error_help(code::FORM, node.span, "`final` names an outcome", &help);
        if !matches!(node.value, Yaml::Map(_) | Yaml::List(_)) {
            self.findings.remedy(Remedy::replace(node.span, outcome));
        }
    }

    /// `Name`, `[A.X, B.Y]` for states of several regions, or `{target, do}`.
    fn entry(&mut self, node: &Node) -> WrittenEntry {
        let Yaml::Map(entries) = &node.value else {
            return WrittenEntry { targets: self.targets(node), actions: Vec::new() };
        };
        self.known(entries, forms::ENTRY, "an initial transition");
        let Some(target) = get(entries, "target") else {
            self.error(code::MISSING_KEY, node.span, "a `target` is needed here");
            return WrittenEntry::default();
        };
        WrittenEntry { targets: self.targets(target), actions: self.actions(get(entries, "do")) }
    }

    /// One name, or a list of them.
    fn targets(&mut self, node: &Node) -> Vec<Named> {
        match &node.value {
            Yaml::List(items) if items.is_empty() => {
                self.form(node, "the name of a state");
                Vec::new()
            }
            Yaml::List(items) => items.iter().filter_map(|n| self.text(n)).collect(),
            _ => self.text(node).into_iter().collect(),
        }
    }

    fn states(&mut self, node: &Node, level: usize) -> Vec<WrittenState> {
        let mut states = Vec::new();
        if let Yaml::List(items) = &node.value {
            let help = "write each as `Name: {skill: ...}`, without `-`";
            self.error_help(code::FORM, node.span, "states stand under their names, not in a list", help);
            if let Some(remedy) = foreign::by_name(&self.findings.source, items) {
                self.findings.remedy(remedy);
            }
            return states;
        }
        let entries = self.entries(node);
        states.reserve_exact(entries.len());
        for (name, node) in entries {
            let entries = self.entries(node);
            states.extend(self.state(name.clone(), node.span, entries, level + 1, false));
        }
        states
    }

    fn retry(&mut self, entries: &Entries) -> Option<Retry> {
        let node = get(entries, "retry")?;
        if let Yaml::Int(times) = node.value {
            let help = format!("write `retry: {{times: {times}, wait: 1s}}`");
            self.error_help(code::FORM, node.span, "`retry` says how often and how long after", &help);
            self.findings.remedy(Remedy::replace(node.span, format!("{{times: {times}, wait: 1s}}")));
            return None;
        }
        let entries = self.entries(node);
        self.known(entries, forms::RETRY, "`retry`");
        let times = match get(entries, "times").map(|n| (&n.value, n.span)) {
            Some((Yaml::Int(n), _)) if (0..=1_000_000).contains(n) => u32::try_from(*n).unwrap_or(0),
            Some((_, span)) => {
                self.error(code::FORM, span, "a number of times is needed here");
                0
            }
            None => 1,
        };
        let wait_s = get(entries, "wait").and_then(|n| self.duration(n)).unwrap_or(0.0);
        Some(Retry { times, wait_s })
    }

    fn watches(&mut self, entries: &Entries) -> Vec<WrittenWatch> {
        let Some(node) = get(entries, "watch") else { return Vec::new() };
        let mut watches = Vec::new();
        for (name, node) in self.entries(node) {
            self.name(name);
            let short;
            let form = if let Yaml::String(_) = &node.value {
                short = vec![(Named { span: node.span, text: "if".into() }, node.clone())];
                &short[..]
            } else {
                self.entries(node)
            };
            self.known(form, forms::WATCH, "a watch");
            let condition = self.required(form, "if", name.span, "a watch needs `if: condition`");
            let Some(condition) = condition else { continue };
            let hold_s = get(form, "for").and_then(|n| self.duration(n)).unwrap_or(0.0);
            let until = get(form, "until").cloned();
            watches.push(WrittenWatch { name: name.clone(), condition: condition.clone(), hold_s, until });
        }
        watches
    }

    fn after(&mut self, entries: &Entries) -> Vec<WrittenTransition> {
        let Some(node) = get(entries, "after") else { return Vec::new() };
        let mut result = Vec::new();
        match &node.value {
            Yaml::List(items) if items.iter().any(|item| !matches!(item.value, Yaml::Map(_))) => {
                let message = "`after` says where it leads when the time is over";
                self.pair_as_a_list(node, items, message, "after");
            }
            Yaml::List(items) => {
                for item in items {
                    let form = self.entries(item);
                    self.known(form, forms::TIMED_TRANSITION, "a timed transition");
                    let Some(delay) = get(form, "for") else {
                        if only_known(form, forms::TIMED_TRANSITION) {
                            let message = "a timed transition needs `for: duration`";
                            self.error(code::MISSING_KEY, item.span, message);
                        }
                        continue;
                    };
                    let mut transition = self.transition(item, None, true);
                    transition.delay = Some(delay.clone());
                    result.push(transition);
                }
            }
            Yaml::String(_) | Yaml::Int(_) | Yaml::Float(_) => {
                let written = self.findings.source.text.get(node.span.start..node.span.end).unwrap_or("5s");
                // A time below 0 is a second mistake.
                let written = written.trim().trim_start_matches('-').to_owned();
                let pair = written.split_once("->").or_else(|| written.split_once("=>"));
                let (time, target) = match pair {
                    Some((time, target)) => (time.trim(), Some(target.trim().to_owned())),
                    None => (written.as_str(), only_target(entries)),
                };
                let help = format!("write `after: {{{time}: {}}}`", target.as_deref().unwrap_or("Target"));
                let message = "`after` says where it leads when the time is over";
                self.error_help(code::FORM, node.span, message, &help);
                if let Some(target) = target {
                    self.findings.remedy(Remedy::replace(node.span, format!("{{{time}: {target}}}")));
                }
            }
            _ => {
                for (key, node) in self.entries(node) {
                    let delay = Node { span: key.span, value: Yaml::String(key.text.clone()) };
                    for mut transition in self.transition_list(node, None) {
                        transition.delay = Some(delay.clone());
                        result.push(transition);
                    }
                }
            }
        }
        result
    }

    fn transitions(&mut self, entries: &Entries) -> Vec<WrittenTransition> {
        let Some(node) = get(entries, "transitions") else { return Vec::new() };
        let mut result = Vec::new();
        // A list where the order of different events matters: `[{event, target, ...}]`.
        if let Yaml::List(items) = &node.value {
            if items.iter().any(|item| !matches!(item.value, Yaml::Map(_))) {
                self.pair_as_a_list(node, items, "transitions stand under their events", "transitions");
                return result;
            }
            for item in items {
                let form = self.entries(item);
                if let [(event, to)] = form
                    && !only_known(form, forms::EVENT_TRANSITION)
                    && foreign::meant(&event.text, to, forms::EVENT_TRANSITION).is_none()
                {
                    self.event_as_a_key(event, to);
                    continue;
                }
                self.known(form, forms::EVENT_TRANSITION, "a transition");
                match get(form, "event").map(|n| self.text(n)) {
                    Some(Some(event)) => {
                        self.event_name(&event);
                        result.push(self.transition(item, Some(&event), true));
                    }
                    Some(None) => {}
                    None if !only_known(form, forms::EVENT_TRANSITION) => {}
                    None => self.error(code::MISSING_KEY, item.span, "a transition needs `event: name` here"),
                }
            }
            return result;
        }
        for (event, node) in self.entries(node) {
            self.event_name(event);
            result.extend(self.transition_list(node, Some(event)));
        }
        result
    }

    /// `[5s, Done]` where `{5s: Done}` is meant.
    fn pair_as_a_list(&mut self, node: &Node, items: &[Node], message: &str, key: &str) {
        let source = Arc::clone(&self.findings.source);
        let written = |node: &Node| source.text.get(node.span.start..node.span.end).map(str::trim);
        let pair = match items {
            [what, Node { value: Yaml::String(target), .. }]
                if !matches!(what.value, Yaml::Map(_) | Yaml::List(_)) =>
            {
                written(what).map(|what| format!("{{{what}: {target}}}"))
            }
            _ => None,
        };
        let example = if key == "after" { "{5s: Target}" } else { "{event: Target}" };
        let help = format!("write `{key}: {}`", pair.as_deref().unwrap_or(example));
        self.error_help(code::FORM, node.span, message, &help);
        let brackets = source.layout().brackets.iter().find(|b| b.open == node.span.start);
        if let (Some(pair), Some(close)) = (pair, brackets.and_then(|brackets| brackets.close)) {
            self.findings.remedy(Remedy::replace(Span { start: node.span.start, end: close + 1 }, pair));
        }
    }

    /// `[{go: Done}]` where `{go: Done}` is meant, or `[{event: go, target: Done}]`.
    fn event_as_a_key(&mut self, event: &Named, to: &Node) {
        let target = match &to.value {
            Yaml::String(target) => target.as_str(),
            _ => "Target",
        };
        let right = format!("event: {}, target: {target}", event.text);
        let message = "in a list, a transition names its event";
        let help =
            format!("write `{{{right}}}`, or all transitions as a map: `{{{}: {target}}}`", event.text);
        self.error_help(code::FORM, event.span, message, &help);
        if let Yaml::String(_) = to.value {
            let braces = self.findings.source.text[..event.span.start].trim_end().ends_with('{');
            let span = Span { start: event.span.start, end: to.span.end };
            let written = if braces { right } else { format!("{{{right}}}") };
            self.findings.remedy(Remedy::replace(span, written));
        }
    }

    fn event_name(&mut self, event: &Named) {
        let pattern = event.text.strip_suffix(".*").unwrap_or(&event.text);
        if event.text != "*" && (pattern.is_empty() || pattern.split('.').any(|t| t.is_empty() || t == "*")) {
            self.error(code::NAME, event.span, format!("`{}` is not the name of an event", event.text));
        }
    }

    fn transition_list(&mut self, node: &Node, event: Option<&Named>) -> Vec<WrittenTransition> {
        match &node.value {
            Yaml::List(items) => items.iter().map(|n| self.transition(n, event, false)).collect(),
            _ => vec![self.transition(node, event, false)],
        }
    }

    fn transition(&mut self, node: &Node, event: Option<&Named>, checked: bool) -> WrittenTransition {
        let mut result = WrittenTransition {
            span: event.map_or(node.span, |e| e.span),
            event: event.cloned(),
            delay: None,
            targets: Vec::new(),
            internal: false,
            guard: None,
            actions: Vec::new(),
            with: Vec::new(),
        };
        if let Yaml::String(target) = &node.value {
            result.targets = vec![Named { span: node.span, text: target.clone() }];
            return result;
        }
        let Yaml::Map(entries) = &node.value else {
            self.form(node, "a target, or `{target, if, do, with}`, or a list of these");
            return result;
        };
        if !checked {
            self.known(entries, forms::TRANSITION, "a transition");
        }
        result.targets = get(entries, "target").map_or_else(Vec::new, |n| self.targets(n));
        result.internal = self.flag(entries, "internal");
        result.guard = get(entries, "if").cloned();
        result.actions = self.actions(get(entries, "do"));
        result.with = get(entries, "with").map_or_else(Vec::new, |n| self.entries(n).to_vec());
        result
    }
}
