//! Features of SCXML, one document each: raised events, blocks, delays, history, parallel states, names. Written
//! from the recommendation; each document must end in the final state `pass`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::collections::BTreeMap;
use std::time::Duration;

use armarium_runtime::chart::{ChannelSchema, Registry, check, load_text};
use armarium_runtime::import;
use armarium_runtime::stepping::Stepper;

/// Name, the document's `initial`, and its content besides the final states `pass` and `fail`.
#[rustfmt::skip]
const DOCUMENTS: &[(&str, &str, &str)] = &[
    ("raise_order", "s", "<state id='s'><onentry><raise event='foo'/><raise event='bar'/></onentry><transition event='foo' target='t'/><transition event='*' target='fail'/></state><state id='t'><transition event='bar' target='pass'/><transition event='*' target='fail'/></state>"),
    ("internal_before_external", "", "<state id='s0'><onentry><send event='event1'/><send event='event2' target='#_internal'/></onentry><transition event='event1' target='fail'/><transition event='event2' target='pass'/></state>"),
    ("send_type", "", "<state id='s0'><onentry><send event='e' type='http://www.w3.org/TR/scxml/#SCXMLEventProcessor'/></onentry><transition event='e' target='pass'/><transition event='*' target='fail'/></state>"),
    ("delayexpr", "", "<state id='s0'><onentry><send event='event2' delayexpr=\"'1s'\"/><send event='event1'/></onentry><transition event='event1' target='s1'/><transition event='*' target='fail'/></state><state id='s1'><transition event='event2' target='pass'/><transition event='*' target='fail'/></state>"),
    ("cancel", "", "<state id='s0'><onentry><send id='foo' event='event1' delay='1s'/><send event='event2' delay='1.5s'/><cancel sendid='foo'/></onentry><transition event='event2' target='pass'/><transition event='*' target='fail'/></state>"),
    ("cancelexpr", "", "<state id='s0'><onentry><send id='foo' event='event1' delay='1s'/><send event='event2' delay='1.5s'/><cancel sendidexpr=\"'foo'\"/></onentry><transition event='event2' target='pass'/><transition event='*' target='fail'/></state>"),
    ("default_initial", "", "<state id='s0'><transition target='pass'/></state><state id='s1'><transition target='fail'/></state>"),
    ("done_parallel", "", "<state id='s0' initial='p0'><onentry><send event='timeout' delay='1s'/></onentry><transition event='timeout' target='fail'/><parallel id='p0'><transition event='done.state.p0' target='pass'/><state id='s1' initial='a'><state id='a'><transition target='f1'/></state><final id='f1'/></state><state id='s2' initial='b'><state id='b'><transition target='f2'/></state><final id='f2'/></state></parallel></state>"),
    ("done_compound", "", "<state id='s0' initial='s01'><onentry><send event='timeout' delay='1s'/></onentry><transition event='timeout' target='fail'/><transition event='done.state.s0' target='fail'/><state id='s01' initial='s011'><transition event='done.state.s01' target='pass'/><state id='s011'><transition target='s02'/></state><final id='s02'/></state></state>"),
    ("exit_order", "p", "<state id='p0x'><transition target='fail'/></state><state id='p'><onexit><raise event='event4'/></onexit><transition target='s2'/><state id='s1p'><onexit><raise event='event3'/></onexit><parallel id='pp'><onexit><raise event='event2b'/></onexit><state id='a'><onexit><raise event='event2'/></onexit></state><state id='b'><onexit><raise event='event1'/></onexit></state></parallel></state></state><state id='s2'><transition event='event1' target='s3'/><transition event='*' target='fail'/></state><state id='s3'><transition event='event2' target='s4'/><transition event='*' target='fail'/></state><state id='s4'><transition event='event2b' target='s5'/><transition event='*' target='fail'/></state><state id='s5'><transition event='event3' target='s6'/><transition event='*' target='fail'/></state><state id='s6'><transition event='event4' target='pass'/><transition event='*' target='fail'/></state>"),
    ("in_during_entry", "s0", "<state id='s0' initial='s01'><onentry><if cond=\"In('s01')\"><raise event='no'/><else/><raise event='yes'/></if></onentry><transition event='yes' target='pass'/><transition event='no' target='fail'/><state id='s01'/></state>"),
    ("in_during_exit", "s0", "<state id='s0' initial='s01'><onexit><if cond=\"In('s01')\"><raise event='no'/><else/><raise event='yes'/></if></onexit><transition target='s2'/><state id='s01'/></state><state id='s2'><transition event='yes' target='pass'/><transition event='no' target='fail'/></state>"),
    ("initial_content", "s0", "<state id='s0'><onentry><raise event='event1'/></onentry><initial><transition target='s01'><raise event='event2'/></transition></initial><state id='s01'><onentry><raise event='event3'/></onentry><transition event='event1' target='s1'/><transition event='*' target='fail'/></state><state id='s1'><transition event='event2' target='s2'/><transition event='*' target='fail'/></state><state id='s2'><transition event='event3' target='s3'/><transition event='*' target='fail'/></state><state id='s3'><transition target='xx'/></state><final id='xx'/><transition event='done.state.s0' target='pass'/></state>"),
    ("history_content", "s0", "<state id='s0' initial='sh1'><onentry><send delay='1s' event='timeout'/></onentry><transition event='timeout' target='fail'/><transition event='event1' target='fail'/><history id='sh1'><transition target='s01'><raise event='event2'/></transition></history><state id='s01'><onentry><raise event='event1'/></onentry><transition event='event2' target='s02'/><transition event='event1' target='s03'/></state><state id='s02'><transition event='event1' target='pass'/></state><state id='s03'><transition event='event2' target='pass'/></state></state>"),
    ("initial_deep_parallel", "s11p112 s11p122", "<state id='s0'><transition target='fail'/></state><state id='s1'><onentry><send event='timeout' delay='1s'/></onentry><transition event='timeout' target='fail'/><state id='s11' initial='s111'><state id='s111'/><parallel id='s11p1'><state id='s11p11' initial='s11p111'><state id='s11p111'/><state id='s11p112'><onentry><raise event='In-s11p112'/></onentry></state></state><state id='s11p12' initial='s11p121'><state id='s11p121'/><state id='s11p122'><transition event='In-s11p112' target='pass'/></state></state></parallel></state></state>"),
    ("illegal_target", "", "<state id='s0'><onentry><send event='e1' target='baz'/><raise event='next'/></onentry><transition event='error.execution' target='pass'/><transition event='*' target='fail'/></state>"),
    ("error_stops_block", "", "<state id='s0'><onentry><send event='thisWillFail' target='!invalid'/><raise event='event2'/></onentry><transition event='event2' target='fail'/><transition event='error.*' target='s1'/></state><state id='s1'><transition event='event2' target='fail'/><transition target='pass'/></state>"),
    ("log_any", "", "<state id='s0'><onentry><log label='a' expr='1 + 1'/><log expr='1'/></onentry><transition target='pass'/></state>"),
    ("send_namelist_free", "", "<state id='s0'><onentry><send event='e'><param name='a' expr='1'/></send></onentry><transition event='e' target='pass'/></state>"),
    ("eventexpr", "", "<state id='s0'><onentry><send eventexpr=\"'e'\" targetexpr=\"'#_internal'\"/></onentry><transition event='e' target='pass'/></state>"),
    ("donedata", "", "<state id='s0' initial='i'><state id='i'><transition target='f'/></state><final id='f'><donedata><param name='x' expr='1'/></donedata></final><transition event='done.state.s0' target='pass'/></state>"),
    ("prefix_dot", "", "<state id='s0'><onentry><raise event='foo.bar'/></onentry><transition event='foo.b' target='fail'/><transition event='foos' target='fail'/><transition event='foo.' target='pass'/></state>"),
    ("prefix_list", "", "<state id='s0'><onentry><raise event='foo.zoo'/></onentry><transition event='bar foo.*' target='pass'/><transition event='*' target='fail'/></state>"),
    ("case_sensitive", "", "<state id='s0'><onentry><raise event='FOO'/></onentry><transition event='foo' target='fail'/><transition event='FOO' target='pass'/></state>"),
    ("ancestor_last", "s0", "<state id='s0' initial='s01'><onentry><raise event='e'/></onentry><transition event='e' target='fail'/><state id='s01'><transition event='e' target='s02'/></state><state id='s02'><transition target='pass'/></state></state>"),
    ("preempt", "p", "<parallel id='p'><onentry><raise event='e1'/><raise event='e2'/></onentry><transition event='e2' target='fail'/><state id='a'><transition event='e1' target='pass2'/></state><state id='b'><transition event='e1' target='p'/></state></parallel><state id='pass2'><onentry><raise event='x'/></onentry><transition event='x' target='pass'/><transition event='e2' target='pass'/></state>"),
    ("internal_transition", "s1", "<state id='s1' initial='s11'><onexit><raise event='left'/></onexit><onentry><raise event='go'/></onentry><transition event='go' type='internal' target='s12'/><transition event='left' target='fail'/><state id='s11'/><state id='s12'><onentry><send event='x'/></onentry><transition event='left' target='fail'/><transition event='x' target='pass'/></state></state>"),
    ("internal_from_parallel_is_external", "p", "<parallel id='p'><onexit><raise event='left'/></onexit><transition event='go' type='internal' target='b2'/><transition event='left' target='pass'/><state id='a'/><state id='b' initial='b1'><onentry/><state id='b1'><onentry><send event='go'/></onentry></state><state id='b2'><onentry><send event='late'/></onentry></state></state></parallel>"),
    ("targetless", "s", "<state id='s'><onentry><raise event='t'/></onentry><onexit><raise event='left'/></onexit><transition event='t'><raise event='u'/></transition><transition event='left' target='fail'/><transition event='u' target='pass'/></state>"),
    ("no_ids", "", "<state><transition target='pass'/></state>"),
    ("if_elseif", "", "<state id='s0'><onentry><if cond='false'><raise event='a'/><elseif cond='true'/><raise event='b'/><elseif cond='true'/><raise event='c'/><else/><raise event='d'/></if></onentry><transition event='b' target='s1'/><transition event='*' target='fail'/></state><state id='s1'><onentry><raise event='z'/></onentry><transition event='z' target='pass'/><transition event='*' target='fail'/></state>"),
    ("final_onentry_order", "s0", "<state id='s0' initial='i'><state id='i'><transition target='f'/></state><final id='f'><onentry><raise event='first'/></onentry><onexit><raise event='third'/></onexit></final><transition event='first' target='x'/><transition event='done.state.s0' target='fail'/></state><state id='x'><transition event='done.state.s0' target='y'/><transition event='*' target='fail'/></state><state id='y'><transition event='third' target='pass'/></state>"),
    ("event_name", "", "<state id='s0'><onentry><raise event='foo'/></onentry><transition event='*' cond=\"_event.name == 'foo'\" target='pass'/><transition event='*' target='fail'/></state>"),
    ("history_default2", "s0", "<state id='s0'><initial><transition target='s01'/></initial><onentry><send event='timeout' delay='2s'/></onentry><transition event='timeout' target='fail'/><state id='s01'><initial><transition target='sh'/></initial><history id='sh' type='shallow'><transition target='s012'/></history><state id='s011'><transition target='fail'/></state><state id='s012'><transition target='pass'/></state></state></state>"),
    ("onexit_order", "s0", "<state id='s0'><onexit><raise event='event1'/></onexit><onexit><raise event='event2'/></onexit><transition target='s1'/></state><state id='s1'><transition event='event1' target='s2'/><transition event='*' target='fail'/></state><state id='s2'><transition event='event2' target='pass'/><transition event='*' target='fail'/></state>"),
    ("unmatched_error_ignored", "s0", "<state id='s0'><onentry><send event='a' target='!invalid'/></onentry><onentry><send event='t' delay='1s'/></onentry><transition event='t' target='pass'/></state>"),
    ("unreachable_session", "s0", "<state id='s0'><onentry><send event='a' target='#_scxml_foo'/></onentry><onentry><send event='t' delay='1s'/></onentry><transition event='error.communication' target='pass'/><transition event='*' target='fail'/></state>"),
    ("reenter_self", "a", "<state id='a'><onexit><raise event='x'/></onexit><transition event='go' target='a'/><transition event='x' target='pass'/><onentry><send event='go'/></onentry></state>"),
    ("multi_targets", "p", "<parallel id='p'><state id='a' initial='a1'><state id='a1'/><state id='a2'/></state><state id='b' initial='b1'><state id='b1'/><state id='b2'/></state><onentry><send event='g'/></onentry><transition event='g' target='a2 b2'/><transition cond=\"In('a2') &amp;&amp; In('b2')\" target='pass'/></parallel>"),
    ("conflict_par", "p", "<parallel id='p'><onentry><raise event='e'/></onentry><state id='r1' initial='x'><state id='x'><transition event='e' target='y'/></state><state id='y'/></state><state id='r2'><transition event='e' target='fail'/></state><transition cond=\"In('y')\" target='pass'/></parallel>"),
    ("top_final_parallel", "w", "<state id='w' initial='p'><parallel id='p'><state id='r1'><final id='f1'/></state><state id='r2'><final id='f2'/></state></parallel><transition event='done.state.p' target='pass'/></state>"),
    ("weird_ids", "if", "<state id='if'><transition target='a-b'/></state><state id='a-b'><transition target='done'/></state><state id='done' initial='1'><state id='1'><transition target='x.y'/></state><final id='x.y'/><transition event='done.state.done' target='pass'/></state>"),
    ("send_after_leave", "a", "<state id='a'><onentry><send event='z' delay='20ms'/></onentry><transition target='b'/></state><state id='b'><transition event='z' target='pass'/></state>"),
    ("delays", "a", "<state id='a'><onentry><send event='l' delay='0.5s'/><send event='s' delay='.1s'/><send event='m' delay='200ms'/></onentry><transition event='s' target='b'/><transition event='*' target='fail'/></state><state id='b'><transition event='m' target='c'/><transition event='*' target='fail'/></state><state id='c'><transition event='l' target='pass'/></state>"),
];

fn rests_in(name: &str, initial: &str, inside: &str) -> Result<Vec<String>, String> {
    let initial = if initial.is_empty() { String::new() } else { format!(" initial='{initial}'") };
    let document = format!(
        "<scxml xmlns='http://www.w3.org/2005/07/scxml' version='1.0'{initial}>{inside}<final id='pass'/>\
         <final id='fail'/></scxml>"
    );
    let imported = import::scxml(&document, name).map_err(|errors| format!("{errors:?}"))?;
    let checked =
        check(&load_text("imported.yaml", &imported.yaml, &[]), &Registry::new(), &ChannelSchema::new());
    let program = checked.program.ok_or_else(|| format!("{:?}\n{}", checked.findings, imported.yaml))?;
    let mut stepper = Stepper::new(program, &BTreeMap::new(), None).map_err(|e| e.to_string())?;
    stepper.start();
    stepper.advance(Duration::from_secs(10));
    Ok(stepper.snapshot().configuration)
}

#[test]
fn every_document_comes_to_rest_where_the_recommendation_says() {
    let wrong = DOCUMENTS.iter().filter_map(|(name, initial, inside)| {
        let found = rests_in(name, initial, inside);
        (found != Ok(vec!["pass".to_owned()])).then(|| format!("{name}: {found:?}"))
    });
    let wrong: Vec<String> = wrong.collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
