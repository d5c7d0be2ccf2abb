//! Mechanisms to start from: examples that are part of the program.

/// A mechanism file.
pub struct Template {
    /// Name on the command line.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    text: &'static str,
}

impl Template {
    const fn new(name: &'static str, about: &'static str, text: &'static str) -> Self {
        Self { name, about, text }
    }

    /// The template of a name.
    pub fn of(name: &str) -> Option<&'static Self> {
        TEMPLATES.iter().find(|template| template.name == name)
    }

    /// Text of the mechanism file, without comments that are about the example.
    pub fn file(&self) -> String {
        let is_of_example = |line: &&str| line.starts_with('#') && line.contains("metafmu new");
        let lines = self.text.lines().filter(|line| !is_of_example(line));
        lines.flat_map(|line| [line, "\n"]).collect()
    }
}

/// All templates; each is proposed with the structure "dynamics".
pub const TEMPLATES: [Template; 14] = [
    Template::new("pendulum", "with a motor at its pivot", include_str!("../examples/dynamics/pendulum.toml")),
    Template::new("double-pendulum", "with a motor", include_str!("../examples/dynamics/double-pendulum.toml")),
    Template::new("crane", "whose trolley a motor moves", include_str!("../examples/dynamics/crane.toml")),
    Template::new(
        "servo-crane",
        "whose trolley follows a drive",
        include_str!("../examples/dynamics/servo-crane.toml"),
    ),
    Template::new("four-bar", "linkage with a torque", include_str!("../examples/dynamics/four-bar.toml")),
    Template::new("slider-crank", "with a torque", include_str!("../examples/dynamics/slider-crank.toml")),
    Template::new("quarter-car", "on a road", include_str!("../examples/dynamics/quarter-car.toml")),
    Template::new("wishbone", "suspension with stops", include_str!("../examples/dynamics/parts/wishbone.toml")),
    Template::new("motor", "with gear, arm and controller", include_str!("../examples/dynamics/parts/motor.toml")),
    Template::new("cam", "under a valve", include_str!("../examples/dynamics/parts/cam.toml")),
    Template::new("rack", "and pinion between stops", include_str!("../examples/dynamics/parts/rack.toml")),
    Template::new("mount", "of an engine, with a bushing", include_str!("../examples/dynamics/parts/mount.toml")),
    Template::new("wheel", "that is driven and slips", include_str!("../examples/dynamics/parts/wheel.toml")),
    Template::new("chain", "of five sprung links", include_str!("../examples/dynamics/parts/chain.toml")),
];

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_multibody::Mechanism;
    use std::path::Path;

    #[test]
    fn each_is_a_mechanism_file() {
        for template in &TEMPLATES {
            let text = template.file();
            assert!(!text.contains("examples/"), "{}", template.name);
            Mechanism::parse(&text, Path::new(template.name)).unwrap();
        }
    }
}
