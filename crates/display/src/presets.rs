//! Displays that come with the program: the paper's prototypes, and the displays of its figures.

macro_rules! presets {
    ($($name:literal),* $(,)?) => {
        /// Name and text of every preset.
        pub const PRESETS: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../displays/", $name, ".toml")))),*];
    };
}

presets!(
    "paper-three-layer",
    "paper-directional",
    "fig4-two-layer",
    "fig4-three-layer-static",
    "fig4-three-layer",
    "fig4-one-layer-directional",
    "fig4-two-layer-directional",
    "fig7-uniform",
    "fig7-directional",
    "fig9-five-layer",
    "fig9-multilayer-only",
    "fig9-multiframe-only",
    "fig9-directional",
);
