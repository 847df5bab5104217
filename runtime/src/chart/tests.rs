use std::collections::BTreeMap;

use armarium_source::code;

use super::testing::{findings, program};
use super::*;

/// The findings of one chart, as text.
fn found(text: &str) -> String {
    findings(text, &BTreeMap::new())
}

#[test]
fn a_chart_that_is_in_order_has_no_findings() {
    assert_eq!(
        found(
            "
statechart: Wipe
inputs: {force: {type: float, unit: N, default: 8 N, maximum: 15.0}, patience: {type: duration, default: 60s}}
types: {Gesture: {enum: [fist, open_hand]}}
locals: {seen: {type: Gesture, default: fist}}
events: {said: {data: {word: string}}}
limits: {force: 40 N, speed: 0.4 m/s}
initial: A
states:
  A:
    parallel:
      X: {initial: Go, states: {Go: {skill: Arm, with: {force: \"${inputs.force}\"}, transitions: {success: Go}}}}
      Y:
        initial: Look
        states:
          Look:
            watch:
              pushed: {if: \"norm(channels.wrist.push) > 6.0\", for: 100ms}
              gesture: {if: \"channels.hand.gesture != 'none' && age('hand') < 0.3\", for: 200ms}
            transitions: {pushed: Look, gesture: Look}
    after: {\"${inputs.patience}\": Done}
    transitions: {failure: Failed, said: Done, \"error.*\": Failed}
  Done: {final: success}
  Failed: {final: failure}
"
        ),
        ""
    );
}

/// Each wrong chart, the code, the text at its place, and a part of the message or help.
#[test]
fn mistakes_are_found_with_code_place_and_help() {
    let states = |state: &str| format!("statechart: T\ninitial: A\nstates:\n  A: {state}\n  B: {{}}\n");
    let cases: Vec<(String, &str, &str, &str)> = vec![
        (states("{after: {1s: C}}"), code::STATE, "C", "no state"),
        (states("{transitons: {}}"), code::KEY, "transitons", "did you mean `transitions`"),
        (states("{skill: Akt}"), code::SKILL, "Akt", "did you mean `Act`"),
        (states("{skill: Act, with: {forse: 1}}"), code::INPUT, "forse", "did you mean `force`"),
        (states("{skill: Act, with: {force: 1 m}}"), code::UNIT, "1 m", "number in N"),
        (states("{skill: Act, with: {force: [1]}}"), code::TYPE, "[", "expected float in N"),
        (states("{skill: Act, with: {for: \"${1 + x}\"}}"), code::VARIABLE, "x", "no `x`"),
        (states("{skill: Act, with: {end: \"${A.valeu}\"}}"), code::VARIABLE, "A.valeu", "did you mean `A.value`"),
        (states("{skill: Act, with: {for: \"${1 +}\"}}"), code::EXPRESSION, "+", "no value after"),
        (states("{skill: Act, with: {force: \"${nrm([1.0])}\"}}"), code::FUNCTION, "(", "did you mean `norm`"),
        (states("{skill: Act, transitions: {succes: B}}"), code::EVENT, "succes", "did you mean `success`"),
        (states("{watch: {w: \"channels.wirst.push[0] > 1\"}}"), code::CHANNEL, "channels.wirst", "did you mean `wrist`"),
        (states("{watch: {w: \"norm(channels.wrist.push)\"}}"), code::TYPE, "\"norm", "true or false"),
        (states("{skill: Act, states: {}}"), code::KIND, "states", "both `skill` and `states`"),
        (states("{statechart: Nowhere}"), code::CHART, "Nowhere", "no chart"),
        (states("{statechart: T}"), code::CYCLE, "T", "contain each other"),
        (states("{initial: X, states: {Y: {}}}"), code::STATE, "X", "did you mean `Y`"),
        (states("{after: {1 N: B}}"), code::UNIT, "1 N", "number in s"),
        (states("{enter: [{asign: {}}]}"), code::KEY, "asign", "did you mean `assign`"),
        (states("{enter: [{assign: {locals.n: 1}}]}"), code::VARIABLE, "locals.n", "no `locals.n`"),
        (states("{limits: {force: 3 m}}"), code::UNIT, "3 m", "number in N"),
        (states("{remote: bob}"), code::REMOTE, "bob", "agent/Name"),
        (states("{skill: Act, with: {force: \"${A.value}\"}}"), code::EARLY, "A.value", "nothing lets `A` end"),
        (states("{skill: Act, with: {force: \"${B.value}\"}, transitions: {success: B}}").replace("B: {}", "B: {skill: Act}"), code::EARLY, "B.value", "nothing lets `B` end"),
        (states("{transitions: {t: {target: [A, B]}}}") + "events: {t: {}}\n", code::TOGETHER, "A", "not in two regions"),
        (states("{transitions: {t: {target: B, if: \"event.data.wrd == 'x'\"}}}") + "events: {t: {data: {word: string}}}\n", code::VARIABLE, "event.data.wrd", "did you mean `word`"),
        (states("{transitions: {t: {target: B, if: \"event.data.n == 'x'\"}}}") + "events: {t: {data: {n: int}}}\n", code::TYPE, "", "int"),
        (states("{enter: [{raise: {event: t, data: {n: many}}}]}") + "events: {t: {data: {n: int}}}\n", code::TYPE, "{n: many", "expected int"),
        (states("{enter: [{raise: t}]}") + "events: {t: {data: {n: int}}}\n", code::TYPE, "t}]", "comes with data: n"),
        (states("{transitions: {t: B}}") + "events: {t: {data: {n: itn}}}\n", code::DECLARED_TYPE, "itn", "did you mean `int`"),
        (states("{transitions: [{target: B}]}"), code::MISSING_KEY, "{target", "event"),
        (states("3"), code::FORM, "3", "a map is needed"),
        ("statechart: T\ninitial: A\nstates: {A: {}, A: {}}\n".into(), code::YAML, "A: {}}", "there twice"),
        ("statechart: T\nstates: {A: {}}\n".into(), code::MISSING_KEY, "states", "initial"),
        ("statechart: T\ninputs: {x: {type: flaot}}\ninitial: A\nstates: {A: {}}\n".into(), code::DECLARED_TYPE, "flaot", "did you mean `float`"),
        ("statechart: T\ninputs: {x: {type: float, default: 9.0, maximum: 5.0}}\ninitial: A\nstates: {A: {}}\n".into(), code::TYPE, "9.0", "outside"),
        ("statechart: T\ninitial: if\nstates: {if: {}}\n".into(), code::NAME, "if", "word of the language"),
        ("statechart: T\nparallel: {A: {skill: Arm}, B: {skill: Arm}}\n".into(), code::LIMB, "B", "arm_right"),
        ("statechart: T\n  x: [\n".into(), code::YAML, "  x", "indented by 2"),
        ("initial: A\n".into(), code::MISSING_KEY, "initial", "statechart: Name"),
    ];
    for (text, expected, at, words) in &cases {
        let library = load_text("test.yaml", text, &[]);
        let checked = check(&library, &testing::registry(), &testing::schema());
        let finding =
            checked.findings.iter().find(|f| f.is_error()).unwrap_or_else(|| panic!("nothing in {text}"));
        let shown = format!("{text}\n{finding}");
        assert_eq!(finding.code, *expected, "{shown}");
        assert!(text[finding.span.start..].starts_with(at), "{shown}\nat {:?}", &text[finding.span.start..]);
        assert!(finding.to_string().contains(words), "{shown}");
        assert!(checked.program.is_none());
    }
}

#[test]
fn warnings_do_not_keep_a_chart_from_running() {
    let text = "
statechart: T
initial: A
states:
  A: {skill: Act, transitions: {blocked: [B, C]}}
  B: {}
  C: {}
  D: {}
";
    let said = found(text);
    for words in ["W101]: nobody handles the outcome `success` of `A`", "W102]: the state `D`", "W103]"] {
        assert!(said.contains(words), "{said}");
    }
    program(text);
}

#[test]
fn a_parallel_state_of_which_one_region_never_ends_needs_no_outcome_handled() {
    let chart = |second: &str| {
        format!(
            "statechart: T\ninitial: P\nstates:\n  P:\n    parallel:\n      A: {{initial: X, states: {{X: {{final: success}}}}}}\n      \
             B: {{initial: Y, states: {{Y: {second}}}}}\n"
        )
    };
    assert_eq!(found(&chart("{}")), "");
    assert!(found(&chart("{final: success}")).contains("nobody handles the outcome `success` of `P`"));
}

#[test]
fn all_findings_come_at_once_in_order() {
    let said = found("statechart: T\ninitial: X\nstates:\n  A: {skill: Akt}\n  B: {transitions: {t: C}}\n");
    let codes: Vec<&str> = said.lines().map(|l| &l[l.find('[').unwrap() + 1..][..4]).collect();
    assert_eq!(codes, ["E010", "E012", "E022", "E010"], "{said}");
}

#[test]
fn charts_are_found_by_name_and_hand_values_over() {
    let inner = "
statechart: Inner
inputs: {force: {type: float, unit: N}}
outputs: {value: {type: float, default: 0.0}}
initial: Go
states:
  Go: {skill: Arm, with: {force: \"${inputs.force}\"}, transitions: {success: Done}}
  Done: {final: success}
";
    let outer = |with: &str| {
        format!(
            "
statechart: Outer
initial: A
states:
  A: {{statechart: Inner{with}, transitions: {{success: B}}}}
  B: {{skill: Arm, with: {{force: \"${{A.value}}\"}}, transitions: {{success: Done}}}}
  Done: {{final: success}}
"
        )
    };
    let others = BTreeMap::from([("inner.yaml", inner)]);
    assert_eq!(findings(&outer(", with: {force: 3 N}"), &others), "");
    assert!(findings(&outer(""), &others).contains("E015]: `A` needs the input `force`"));
    let others = BTreeMap::from([("inner.yaml", inner), ("second.yaml", inner)]);
    assert!(findings(&outer(", with: {force: 3 N}"), &others).contains("two charts are called `Inner`"));
    let broken =
        BTreeMap::from([("broken.yaml", "statechart: Inner\ninitial: A\nstates: {A: {skill: Nope}}\n")]);
    assert!(findings(&outer(""), &broken).contains("broken.yaml:3:21: error[E012]"));
}

/// A chart of `n` states inside one another.
fn deep(n: usize) -> String {
    let mut text = String::from("statechart: T\n");
    for level in 0..n {
        let pad = "  ".repeat(2 * level);
        text += &format!("{pad}initial: A\n{pad}states:\n{pad}  A:\n");
    }
    text + &"  ".repeat(2 * n) + "{}\n"
}

/// Aliases that stand for 9^9 words.
fn alias_bomb() -> String {
    (1..9).fold("a0: &a0 [x,x,x,x,x,x,x,x,x]\n".to_owned(), |text, i| {
        let before = format!("*a{},", i - 1).repeat(9);
        text + &format!("a{i}: &a{i} [{}]\n", before.trim_end_matches(','))
    })
}

#[test]
fn hostile_files_are_refused() {
    assert_eq!(found(&deep(55)), "");
    for text in [
        deep(70),
        deep(400),
        "[".repeat(100_000),
        "a: &a [x]\n".to_owned() + &"b: [*a, *a, *a, *a]\n".repeat(10),
        format!(
            "a: &a {}\nb: &b [{}]\nc: &c [{}]\nd: [{}]\n",
            "[x,x,x,x,x,x,x,x]",
            "*a,".repeat(200),
            "*b,".repeat(200),
            "*c,".repeat(200)
        ),
        "statechart: \u{0}\n".into(),
        String::new(),
        "statechart: T\ninitial: A\nstates: {A: {watch: {w: \"".to_owned()
            + &"1+".repeat(3000)
            + "1 > 0\"}}}\n",
    ] {
        assert!(found(&text).contains("error["), "{}", &text[..text.len().min(60)]);
    }
}

/// What is said of files that are no YAML, with the place.
#[test]
fn what_is_no_yaml_is_explained() {
    for (text, said) in [
        ("statechart: T\nstates:\n\tA: {}\n", "3:"),
        ("statechart: T\nstates:\n\tA: {}\n", "indent with spaces"),
        (
            "statechart: T\ninitial: A\nstates:\n  A: {}\n  A: {}\n",
            "5:3: error[E002]: the key `A` is there twice",
        ),
        ("statechart: T\ninitial: A\nstates: {A: {}}\n---\nb: 1\n", "a second document begins here"),
        ("statechart: T\nlocals: {x: {type: float, default: .nan}}\n", "no finite number"),
        (&"[".repeat(10_000), "this is nested too deep"),
        (&alias_bomb(), "its aliases make it too large"),
    ] {
        let said_here = found(text);
        assert!(said_here.contains(said), "{said}: {said_here}");
        assert!(!said_here.contains(" at line "), "{said_here}");
    }
    // Windows' ends of lines and a mark at the beginning are no mistakes, and move no place.
    assert_eq!(found("\u{feff}statechart: T\r\ninitial: A\r\nstates: {A: {}}\r\n"), "");
    assert!(
        found("\u{feff}statechart: T\r\ninitial: B\r\nstates: {A: {}}\r\n").contains("2:10: error[E010]")
    );
}

#[test]
fn an_output_that_some_way_provides_is_no_error() {
    let chart = |rest: &str| format!("statechart: T\ninitial: A\nstates:\n{rest}");
    for text in [
        // After it, in a ring, around a composite, from another region, by another try.
        chart(
            "  A: {skill: Act, transitions: {success: B}}\n  B: {skill: Act, with: {force: \"${A.value}\"}, transitions: {success: A}}\n",
        ),
        chart(
            "  A: {transitions: {t: C}}\n  B: {skill: Act, transitions: {success: A}}\n  C: {skill: Act, with: {force: \"${B.value}\"}, transitions: {success: B}}\nevents: {t: {}}\n",
        ),
        chart(
            "  A: {initial: I, states: {I: {skill: Act, transitions: {success: J}}, J: {final: success}}, transitions: {success: B}}\n  B: {skill: Act, with: {force: \"${A.I.value}\"}}\n",
        ),
        chart(
            "  A: {parallel: {L: {skill: Act}, R: {initial: X, states: {X: {skill: Act, with: {force: \"${A.L.value}\"}}}}}}\n",
        ),
        chart(
            "  A: {retry: {times: 2}, initial: X, states: {X: {skill: Act, with: {force: \"${A.Y.value}\"}, transitions: {success: Y}}, Y: {skill: Act}}}\n",
        ),
    ] {
        let said = found(&text);
        assert!(!said.contains("error"), "{text}\n{said}");
    }
}

/// Each limit is met by a file just within it and refused just over it.
#[test]
fn limits_hold() {
    let states = |n: usize| {
        let mut text = String::from("statechart: T\ninitial: S0\nstates:\n");
        (0..n).for_each(|i| text += &format!("  S{i}: {{}}\n"));
        text
    };
    assert!(!found(&states(1_000)).contains("error["));
    assert!(found(&states(200_001)).contains("more than 200000 states"));
    assert_eq!(found(&deep(60)), "");
    assert!(found(&deep(61)).contains("deeper than 60 levels"));
    let expression = |n: usize| {
        let sum = "1+".repeat(n / 2 - 3) + "1 > 00";
        format!(
            "statechart: T\ninitial: A\nstates: {{A: {{always: [{{target: B, if: \"{sum}\"}}]}}, B: {{}}}}\n"
        )
    };
    assert!(found(&expression(300)).is_empty());
    assert!(found(&expression(4200)).contains("4096 bytes"));
    let large = format!("statechart: T\n# {}\n", "x".repeat(10_000_000));
    assert!(found(&large).contains("more than 10 MB"));
    assert!(found(&alias_bomb()).contains("E002"));
}

#[test]
fn very_many_mistakes_are_found_in_bounded_time() {
    let mut text = String::from("statechart: T\ninitial: S0\nstates:\n");
    for i in 0..20_000 {
        text += &format!("  S{i}: {{transitions: {{t{i}: X{i}, success: S0}}}}\n");
    }
    assert!(found(&text).lines().count() >= 40_000);
    let many = "a: S1, ".to_owned() + &(0..20_000).map(|i| format!("e{i}: S1, ")).collect::<String>();
    assert!(
        found(&format!("statechart: T\ninitial: S1\nstates: {{S1: {{transitions: {{{many}}}}}}}\n"))
            .contains("E022")
    );
}

#[test]
fn a_name_is_judged_by_what_it_was_looked_up_as_and_not_by_its_letters() {
    for (expression, code) in [
        ("channel_count > 1", "E018"),
        ("locals.channel > 1", "E018"),
        ("state_of_things == 1", "E018"),
        ("channels.wrst.push[0] > 1.0", "E020"),
        ("age('wrst') > 1.0", "E020"),
        ("active('Nowhere')", "E010"),
    ] {
        let text = format!(
            "statechart: T\ninitial: A\nstates: {{A: {{always: {{target: B, if: \"{expression}\"}}}}, B: {{}}}}\n"
        );
        let found = findings(&text, &BTreeMap::new());
        assert!(found.contains(&format!("error[{code}]")), "{expression}: {found}");
        assert_eq!(found.matches("error[").count(), 1, "{found}");
    }
}

#[test]
fn a_literal_out_of_bounds_is_found_at_load() {
    let inner = "statechart: Inner\ninputs: {n: {type: int, maximum: 9}}\ninitial: A\nstates: {A: {}}\n";
    let outer = "statechart: T\ninitial: A\nstates: {A: {statechart: Inner, with: {n: 10}}}\n";
    let found = findings(outer, &BTreeMap::from([("inner.yaml", inner)]));
    assert!(found.contains("E016]: 10 is outside of the allowed range, any to 9"), "{found}");
}

#[test]
fn channels_that_charts_declare_are_known_with_their_fields_and_units() {
    let chart = |channels: &str, watch: &str| {
        format!(
            "statechart: T\nchannels: {channels}\ninitial: A\nstates:\n  A: {{watch: {{w: \"{watch}\"}}, transitions: {{w: B}}}}\n  B: {{final: success}}\n"
        )
    };
    let battery =
        "{battery: {type: {volts: {type: float, unit: V}, cells: list<float>}, description: For people.}}";
    for watch in ["channels.battery.volts < 11.0", "age('battery') > 2.0 && channels.battery.cells[0] < 3.0"]
    {
        assert_eq!(found(&chart(battery, watch)), "");
    }
    for one in ["{room: float}", "{room: {type: float, unit: m}}"] {
        assert_eq!(found(&chart(one, "channels.room > 1.0")), "");
    }
    for (channels, watch, said) in [
        (battery, "channels.battery.volt < 11.0", "there is no field `volt`"),
        (battery, "channels.battery < 11.0", "E016"),
        ("{battery: {}}", "true", "`battery` needs a `type`"),
        ("{battery: {type: {volts: flaot}}}", "true", "E024"),
        ("{battery: {type: float, unit: parsec}}", "true", "E017"),
        ("{battery: {type: {volts: float}, rate: 3}}", "true", "a channel has no key `rate`"),
        ("{battery: {type: float, default: 3}}", "true", "a channel has no key `default`"),
        ("{wrist: float}", "true", "test.yaml:2:12: "),
        ("{wrist: float}", "true", "E008]: there is a channel `wrist` already"),
        ("{in: float}", "true", "E006"),
    ] {
        assert!(found(&chart(channels, watch)).contains(said), "{said}: {}", found(&chart(channels, watch)));
    }
}

#[test]
fn charts_of_one_library_declare_a_channel_in_one_way() {
    let inner = "statechart: Inner\nchannels: {battery: {type: {volts: {type: float, unit: V}}}}\ninitial: A\nstates: {A: {final: success}}\n";
    let outer = |unit: &str| {
        format!(
            "statechart: T\nchannels: {{battery: {{type: {{volts: {{type: float, unit: {unit}, description: Other words.}}}}}}}}\n\
             initial: A\nstates: {{A: {{statechart: Inner, transitions: {{success: B}}}}, B: {{final: success}}}}\n"
        )
    };
    let others = BTreeMap::from([("inner.yaml", inner)]);
    assert_eq!(findings(&outer("V"), &others), "");
    let said = findings(&outer("A"), &others);
    assert!(
        said.contains("inner.yaml:2:12: error[E008]: the channel `battery` is {volts: float in V} here"),
        "{said}"
    );
    assert!(said.contains("and {volts: float in A} in T, test.yaml:2:12"), "{said}");
}
