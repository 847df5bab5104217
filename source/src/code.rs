//! Stable codes of findings, one dialect for all kinds of files. `docs/findings.md` has the same table.

macro_rules! codes {
    ($($(#[doc = $doc:literal])* $name:ident = $code:literal;)*) => {
        $($(#[doc = $doc])* pub const $name: &str = $code;)*
        /// Every code with what it stands for.
        pub const TABLE: &[(&str, &str)] = &[$(($code, concat!($($doc),*))),*];
    };
}

codes! {
    /// The file cannot be read, or is too large.
    FILE = "E001";
    /// The file is not YAML.
    YAML = "E002";
    /// A key that the form does not have.
    KEY = "E003";
    /// A value of the wrong form, for instance a list where a name is needed.
    FORM = "E004";
    /// A key that must be there is missing.
    MISSING_KEY = "E005";
    /// A name that cannot be used.
    NAME = "E006";
    /// A state that is two things at once, or a key that a state of its kind never uses.
    KIND = "E007";
    /// A name that is there twice.
    DUPLICATE = "E008";
    /// More states or levels than are allowed.
    LIMIT = "E009";
    /// A target or state that does not exist.
    STATE = "E010";
    /// A chart that does not exist, or two of one name.
    CHART = "E011";
    /// A skill that does not exist.
    SKILL = "E012";
    /// Charts that contain each other.
    CYCLE = "E013";
    /// An input that the skill or chart does not have.
    INPUT = "E014";
    /// An input that must be given.
    MISSING_INPUT = "E015";
    /// A value of the wrong type.
    TYPE = "E016";
    /// A value in a unit of the wrong kind.
    UNIT = "E017";
    /// A name in an expression that stands for nothing.
    VARIABLE = "E018";
    /// Text that is not an expression.
    EXPRESSION = "E019";
    /// A channel that nobody publishes.
    CHANNEL = "E020";
    /// A function that does not exist.
    FUNCTION = "E021";
    /// An event that nobody raises.
    EVENT = "E022";
    /// Two regions that can command one limb at the same time, as far as literals and defaults say which.
    LIMB = "E023";
    /// A type that does not exist.
    DECLARED_TYPE = "E024";
    /// A chart or skill of another agent that cannot be used.
    REMOTE = "E025";
    /// Targets that cannot be entered together.
    TOGETHER = "E026";
    /// An output that is read before its state can have ended.
    EARLY = "E027";
    /// A value that is impossible, or out of its range.
    VALUE = "E028";
    /// The name of a thing that does not exist: an object, a class, a posture, an arm.
    REFERENCE = "E029";
    /// Transitions that are taken again and again without time between them.
    RESTLESS = "E030";
    /// An outcome that nobody handles.
    UNHANDLED = "W101";
    /// A state that cannot be reached.
    UNREACHABLE = "W102";
    /// A transition that cannot fire.
    SHADOWED = "W103";
    /// A value that has no effect.
    UNUSED = "W104";
    /// A chart or skill of another agent that was not asked.
    UNASKED = "W105";
    /// An end that is waited for and cannot come.
    ENDLESS = "W106";
    /// An output that nothing sets.
    UNSET = "W107";
    /// An event that is raised and that nobody takes.
    UNHEARD = "W108";
    /// A value that looks like something else: a forgotten `${}`, a time without unit.
    SUSPICIOUS = "W109";
    /// A value that is not stated, and what is assumed instead.
    ASSUMED = "W110";
}
