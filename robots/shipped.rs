// The robots that the program carries, each with its files. A new robot is a folder here and its lines below; the
// first one is the robot of a world that names none.
&[
    (
        "armar3",
        &[
            ("robot.yaml", include_bytes!("armar3/robot.yaml")),
            ("armar3.urdf", include_bytes!("armar3/armar3.urdf")),
        ],
    ),
    (
        "pillar7",
        &[
            ("robot.yaml", include_bytes!("pillar7/robot.yaml")),
            ("pillar7.urdf", include_bytes!("pillar7/pillar7.urdf")),
        ],
    ),
    (
        "rover2",
        &[
            ("robot.yaml", include_bytes!("rover2/robot.yaml")),
            ("rover2.urdf", include_bytes!("rover2/rover2.urdf")),
        ],
    ),
]
