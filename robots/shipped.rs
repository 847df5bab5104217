// The robots that the program carries, each with its files. A new robot is a folder here and its lines below; the
// first one is the robot of a world that names none.
&[(
    "armar3",
    &[
        ("robot.yaml", include_bytes!("armar3/robot.yaml")),
        ("armar3.urdf", include_bytes!("armar3/armar3.urdf")),
    ],
)]
