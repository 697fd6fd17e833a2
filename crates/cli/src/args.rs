//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};

use crate::groups::{
    DENOISERS, DisplayArgs, FactorizeArgs, FactorizeDisplayArgs, FieldLookArgs, FileArgs, GeometryArgs, ITERATIONS,
    JobArgs, RenderArgs,
};
use crate::values::Numbers;

/// Heading of the options that every command has. Help pages print these options after the options
/// of the command itself.
const GENERAL: &str = "General options";

/// Turn 3D scenes into glasses-free 3D: render a scene from many directions, and compute the
/// patterns with which a display of stacked layers shows it.
#[derive(Debug, Parser)]
#[command(name = "lumistack", version, max_term_width = 110, args_override_self = true)]
pub(crate) struct Args {
    /// After an error message, print the causes of the error
    #[arg(short, long, global = true, help_heading = GENERAL)]
    pub(crate) verbose: bool,
    /// Print progress and results as JSON, one object per line
    #[arg(long, global = true, help_heading = GENERAL)]
    pub(crate) json: bool,
    /// Number of threads that compute; results do not depend on this number [default: one per
    /// logical core]
    #[arg(long, global = true, value_name = "N", help_heading = GENERAL)]
    pub(crate) threads: Option<usize>,
    /// Use the plugins of a plugin library, or of all plugin libraries in a folder. The file of a
    /// plugin library is named `lumistack_plugin_NAME`, with the system's prefix and suffix. The
    /// plugins of this flag take precedence over plugins with the same id in LUMISTACK_PLUGIN_PATH
    /// and in lumistack/plugins of your data folder. The flag may be given several times
    #[cfg(feature = "dynamic")]
    #[arg(long, global = true, value_name = "FILE|DIR", help_heading = GENERAL)]
    pub(crate) plugin_path: Vec<PathBuf>,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Render a job or a scene, compute the patterns of its display, and write outputs and a report
    #[command(
        after_help = "Examples:\n  lumistack run scenes/still-life/job.toml\n  lumistack run scenes/still-life/job.toml --plan\n      prints the steps of the job, and estimates of their time and memory, but does not run them\n  lumistack run model.glb --display paper-three-layer -o runs/model\n  lumistack run model.glb --times 24 --turn-deg 30 -o runs/walk\n      a sequence of 24 time steps, in which the viewer walks 30° around the scene\n  lumistack run fox.glb --animation Walk --times 24 --duration-s 0.7 -o fox\n      a sequence of 24 time steps, in which the scene's animation plays for 0.7 s\n\nA scene that is given without a job file gets pictures of the layers and a browser simulator as outputs; a sequence gets only pictures. If a run was stopped, the same command continues it.\n\nAn option replaces the value of the job file. The default of an option applies if the job file does not set the value."
    )]
    Run(Run),
    /// Write a job file with comments, from three answers or options: scene, display and outputs
    #[command(after_help = crate::new::EXAMPLES)]
    New(crate::new::New),
    /// Render only the views of a scene, and write them into a folder
    #[command(
        after_help = "Examples:\n  lumistack render model.glb -o views\n      all views of the display, exposed and tone-mapped\n  lumistack render model.glb --linear --layers depth,normal -o views\n      scene-linear radiance, with depth and normals\n  lumistack render model.glb --views 7x7 --only-views 3,* -o row\n      only the middle one of seven rows of views\n\nThe folder contains a picture (OpenEXR) for each view, and lightfield.json, which states the geometry of the rays. `lumistack factorize DIR -o RUN` reads such a folder."
    )]
    Render(Render),
    /// Compute patterns for views that you have, such as those that another program rendered
    #[command(
        after_help = "LIGHT_FIELD is one of these:\n  a folder that `lumistack render` wrote\n  a folder in the layout of the collections HCI or Stanford\n  a quilt, or a picture of tiles\n  an array [view_y][view_x][row][col][rgb] in a .npy file\n\nExamples:\n  lumistack factorize views.npy --fov 20x20 --pitch-mm 2.961 -o runs/views\n  lumistack factorize times --sequence --fov 20x20 --pitch-mm 2.961 -o times-run\n      a sequence, whose time steps are times/t0001.npy, times/t0002.npy, ..."
    )]
    Factorize(Factorize),
    /// Write the picture that a viewer sees on the display of a finished run, from a direction or a
    /// position
    #[command(
        after_help = "Examples:\n  lumistack simulate runs/still-life --view 4,-2 -o view.png\n      a picture from 4° to the right and 2° below\n  lumistack simulate runs/still-life --eye 100,0,2000 -o eye.png\n      a picture from 2 m in front and 100 mm to the right\n  lumistack simulate runs/still-life --sweep 7 -o strip.png\n      seven views from left to right"
    )]
    Simulate(Simulate),
    /// Show the display of a finished run in the browser, where you can look at it from all sides
    #[command(
        after_help = "Examples:\n  lumistack preview runs/still-life\n      the display of this run\n  lumistack preview --solve\n      a page that computes patterns for a model, which you drop onto the page\n\nThe command opens the page in your browser. Other machines cannot open the page. When the run's patterns change, the page shows the new patterns. A folder that the output plugin web_simulator wrote also works on any web server. The file preview.html in this folder opens by a double click."
    )]
    Preview(Preview),
    /// Report the limits that follow from the geometry of displays: depth of field, spectral
    /// support, viewing zone, refresh rate and brightness
    #[command(after_help = crate::analyze::EXAMPLES)]
    Analyze(crate::analyze::Analyze),
    /// Compare many designs of a display for one scene, by a table and plots of PSNR (picture
    /// quality, dB) and brightness. With constraints, the command also proposes a design
    #[command(after_help = crate::sweep::EXAMPLES)]
    Sweep(crate::sweep::Sweep),
    /// Run a job or a sweep on many machines, through Dask (a library for Python) or a farm manager
    #[command(after_help = crate::farm::EXAMPLES)]
    Farm(Box<crate::farm::Farm>),
    /// Compare two runs, the displays of one run, or a run with a photograph of its panels. For two
    /// runs, --focus also writes pictures as seen by an eye that focuses at given distances
    #[command(after_help = crate::compare::EXAMPLES)]
    Compare(crate::compare::Compare),
    /// Show a run on physical panels: each layer on its own panel, one frame after another
    #[command(
        after_help = "Examples:\n  lumistack show --list\n      lists the outputs for panels\n  lumistack show runs/still-life\n      shows each layer on its output\n  lumistack show my-display.toml --pattern crosshairs --only 1\n      shows crosshairs on layer 1, to align a stack\n  lumistack show runs/still-life --preview\n      shows a preview in a window, without panels\n\nKeys: space holds the first frame, or resumes. Comma and full stop show the previous and the next frame. Tab selects a panel, the arrows shift it, and s saves the shifts. r reports how many frames were late, and q ends. In a preview the arrows turn the view.\n\nIf the patterns of the run change, the new patterns appear after the last frame of the current cycle. docs/PANELS.md explains how to build and calibrate a stack."
    )]
    Show(Box<crate::show::Show>),
    /// Show a display, and update it while its scene, settings, time or viewers change
    #[command(after_help = crate::live::EXAMPLES)]
    Live(Box<crate::live::Live>),
    /// Print the contents of a scene, a light field, a layer stack, a run folder, a display or a
    /// job
    Info(Info),
    /// Remove files from run folders: files that stopped runs left behind, and cached results that
    /// the last run did not use. The results of the last run stay
    #[command(
        after_help = "Examples:\n  lumistack clean runs/still-life --dry-run\n      prints the sizes of the files, and removes none\n  lumistack clean runs/*\n      cleans every run, sequence and sweep in the folder runs\n  lumistack clean runs/still-life --all\n      also removes all cached views"
    )]
    Clean(Clean),
    /// List all plugins with their parameters and the library of each, and the libraries that could
    /// not be loaded
    #[command(
        after_help = "Example:\n  lumistack plugins tensor-display\n      lists only this plugin, and describes each allowed value of its parameters"
    )]
    Plugins {
        /// Ids of the plugins to list [default: all plugins]
        #[arg(value_name = "ID")]
        ids: Vec<String>,
    },
    /// List the graphics processors that can compute patterns, and the one that `--device auto`
    /// uses
    Devices,
    /// List the built-in displays (the presets)
    Displays,
    /// Write a display file for your own panels, or measure the positions of the panels from
    /// photographs
    Display {
        #[command(subcommand)]
        what: crate::display::DisplayCommand,
    },
    /// Report which optional software and hardware this machine has, and how to get the missing
    /// parts
    #[command(after_help = crate::doctor::EXAMPLES)]
    Doctor,
    /// Install optional software that some kinds of scene files need
    Setup {
        #[command(subcommand)]
        what: Setup,
    },
    /// Print the JSON Schema of job or display files, with which editors complete and check keys
    #[command(
        after_help = "Example:\n  lumistack schema display > display.schema.json\n\nEditors that use taplo, such as Visual Studio Code with Even Better TOML, need one more line. Write `#:schema ./display.schema.json` as the first line of your display file. The schema of job files includes the parameters of all plugins that are found."
    )]
    Schema {
        /// Kind of file that the schema describes
        what: Schema,
    },
    /// Print a script with which a shell completes commands and options
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Write the manual pages of all commands into a folder
    Man {
        /// The folder; it is created if missing
        folder: PathBuf,
    },
}

/// Files that have a schema.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Schema {
    /// Job files
    Job,
    /// Display files
    Display,
}

/// Software that can be installed.
#[derive(Debug, Subcommand)]
pub(crate) enum Setup {
    /// Install a Python environment with OpenUSD in your data folder, for USD files
    ///
    /// You need this command only if none of the Pythons that Lumistack tries has the package
    /// usd-core or usd-exchange. To read USD files, Lumistack tries only the Python that the
    /// variable LUMISTACK_PYTHON names, if the variable is set. Otherwise it tries the Pythons of
    /// the active virtual and conda environments, then the Python that this command installed, then
    /// the Python on PATH.
    Usd {
        /// Install the package usd-exchange instead of usd-core. With usd-exchange the program also
        /// reads MaterialX files (.mtlx)
        #[arg(long)]
        materialx: bool,
        /// Python that makes the environment [default: the first Python on PATH that is 3.8 or
        /// newer]
        #[arg(long, value_name = "PROGRAM")]
        python: Option<PathBuf>,
    },
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Run {
    /// Job file (.toml) or scene: .gltf, .glb, USD, .blend, .obj, splats (.ply, .spz, .sog), or a
    /// file of another importer plugin
    pub(crate) input: PathBuf,
    /// Do not run. Print the steps of the run, which of them have cached results, and estimates of
    /// time and memory
    #[arg(long)]
    pub(crate) plan: bool,
    #[command(flatten)]
    pub(crate) job: JobArgs,
}

#[derive(Debug, ClapArgs)]
#[command(mut_arg("denoise", |arg| arg.help(format!("{DENOISERS}. Auto means shared if the number of views is automatic, Lumistack's path tracer renders the views, and --only-views is absent; otherwise off"))))]
pub(crate) struct Render {
    /// Job file (.toml) or scene: .gltf, .glb, USD, .blend, .obj, splats (.ply, .spz, .sog), or a
    /// file of another importer plugin
    pub(crate) scene: PathBuf,
    /// Folder for the views
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Write scene-linear radiance in 32 bits, without exposure, tone curve and clipping
    #[arg(long, help_heading = "Views", conflicts_with_all = ["exposure_ev", "tone", "background"])]
    pub(crate) linear: bool,
    /// Also write other data of each view, into a file layers_ROW_COL.exr. LIST has some of these
    /// names, separated by commas: depth (millimetres in front of the display plane), normal,
    /// albedo, variance, coverage
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Views")]
    pub(crate) layers: Vec<lumistack_pipeline::ExtraChannel>,
    /// Render only some views. ROW and COL are the numbers, from 0, in the names view_ROW_COL.exr
    /// of the views' files. Give for each a number, a range such as 0..2 (0, 1 and 2), or * for
    /// all. The flag may be given several times
    #[arg(long, value_name = "ROW,COL", help_heading = "Views")]
    pub(crate) only_views: Vec<lumistack_pipeline::ViewSelection>,
    #[command(flatten)]
    pub(crate) display: DisplayArgs,
    #[command(flatten)]
    pub(crate) render: RenderArgs,
}

#[derive(Debug, ClapArgs)]
#[command(mut_arg("iterations", |arg| arg.help(format!("{ITERATIONS} [default: 50]"))))]
pub(crate) struct Factorize {
    /// The views: a folder, a quilt, a picture of tiles or a .npy file. With --sequence, a folder
    /// that contains the views of each time step
    pub(crate) light_field: PathBuf,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) geometry: GeometryArgs,
    #[command(flatten)]
    pub(crate) look: FieldLookArgs,
    #[command(flatten)]
    pub(crate) display: FactorizeDisplayArgs,
    #[command(flatten)]
    pub(crate) factorize: FactorizeArgs,
    /// Seed of the random numbers; the same seed gives the same results [default: 1]
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Read the folder LIGHT_FIELD as a sequence. The folder contains a folder, a .npy file or a
    /// quilt for each time step. The order of the names is the order of the time steps
    #[arg(long, help_heading = "Sequence")]
    pub(crate) sequence: bool,
    /// Number of iterations at every time step after the first [default: 5]
    #[arg(long, value_name = "N", requires = "sequence", help_heading = "Sequence")]
    pub(crate) sequence_iterations: Option<u32>,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Simulate {
    /// A run folder
    pub(crate) dir: PathBuf,
    /// Direction from the display to an eye that is far away (parallel projection). Angles in
    /// degrees: X to the right, Y up [default, without --eye and --sweep: 0,0]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, conflicts_with_all = ["eye", "sweep"])]
    pub(crate) view: Option<Numbers<2>>,
    /// Position of an eye that is near (perspective projection), millimetres from the display's
    /// centre: X to the right, Y up, Z to the front
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "sweep")]
    pub(crate) eye: Option<Numbers<3>>,
    /// Write N views (1 to 64) side by side, spread evenly over the horizontal field of view
    #[arg(long, value_name = "N")]
    pub(crate) sweep: Option<usize>,
    /// Write the light that the display emits. Without this flag the light is divided by the
    /// brightness scale β, so that the picture is as bright as a picture of the scene
    #[arg(long)]
    pub(crate) raw: bool,
    /// Picture to write: .png (encoded as sRGB) or .exr (linear values)
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Clean {
    /// Folders of runs, sequences, sweeps or rendered views
    #[arg(required = true, value_name = "RUN")]
    pub(crate) dirs: Vec<PathBuf>,
    /// Also remove all cached views, and other files that only save time. No result is lost, but a
    /// later run with other settings renders its views again
    #[arg(long)]
    pub(crate) all: bool,
    /// Report the files that would be removed, but remove none
    #[arg(long)]
    pub(crate) dry_run: bool,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Preview {
    /// A run folder, or a folder that the output plugin `web_simulator` wrote; required without
    /// --solve
    #[arg(required_unless_present = "solve")]
    pub(crate) dir: Option<PathBuf>,
    /// Show another page, which computes patterns in the browser. Drop a model or a light field
    /// onto this page
    #[arg(long, conflicts_with = "dir")]
    pub(crate) solve: bool,
    /// Port of this machine at which the page is served; 0 for any free port
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) port: u16,
    /// Do not open the browser
    #[arg(long)]
    pub(crate) no_open: bool,
}

// `info` describes light fields as they are in their files. So the options that change views when
// they are read have no effect, and are hidden.
#[derive(Debug, ClapArgs)]
#[command(mut_arg("views", |arg| arg.hide(true)))]
#[command(mut_arg("resolution", |arg| arg.hide(true)))]
#[command(mut_arg("focus_px", |arg| arg.hide(true)))]
#[command(mut_arg("mirror_x", |arg| arg.hide(true)))]
#[command(mut_arg("mirror_y", |arg| arg.hide(true)))]
#[command(mut_arg("prefilter", |arg| arg.hide(true)))]
pub(crate) struct Info {
    /// The file or folder, or the name of a built-in display
    pub(crate) file: PathBuf,
    /// Compare the depth of the scene or job with the depth of field of this display, which is a
    /// built-in display or a display file
    #[arg(long, value_name = "NAME|FILE", help_heading = "Depth")]
    pub(crate) display: Option<OsString>,
    /// Camera that sees the scene, by its name or its number from 0. If the camera has a plane of
    /// focus, this plane becomes the display plane
    #[arg(long, value_name = "NAME|N", requires = "display", help_heading = "Depth")]
    pub(crate) camera: Option<String>,
    /// View the scene from this azimuth and elevation, degrees. Azimuth 0 is the front; positive
    /// azimuths lie to the right of the front
    #[arg(long, value_name = "AZ,EL", allow_hyphen_values = true, requires = "display", help_heading = "Depth")]
    pub(crate) look_from: Option<Numbers<2>>,
    /// How the scene is brought into the display's depth of field: auto, off, move or compress.
    /// With move, the window (the display's place in the scene) moves along its normal. With
    /// compress, depth is also compressed if the scene still does not fit. Auto acts as compress,
    /// with these exceptions. Auto changes nothing if the scene fits, or if the depth of field does
    /// not lie on both sides of the display plane. Auto does not move the window if the job has
    /// `window.from = "given"`, or if the job or the camera states a focus distance. Auto does not
    /// compress depth if a depth scale other than 1 is set. Without this option, HOW is the job's,
    /// or auto; `--fit-depth` alone means move
    #[arg(long, value_name = "HOW", num_args = 0..=1, require_equals = true, default_missing_value = "move", value_parser = ["auto", "off", "move", "compress"], requires = "display", help_heading = "Depth")]
    pub(crate) fit_depth: Option<String>,
    #[command(flatten)]
    pub(crate) files: FileArgs,
    #[command(flatten)]
    pub(crate) geometry: GeometryArgs,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_sound() {
        Args::command().debug_assert();
    }

    #[test]
    #[cfg(feature = "dynamic")]
    fn plugin_paths_add_up_on_both_sides_of_the_command() {
        let args = Args::parse_from(["lumistack", "plugins", "--plugin-path", "a", "--plugin-path=b"]);
        assert_eq!(args.plugin_path, ["a", "b"].map(PathBuf::from));
        assert_eq!(Args::parse_from(["lumistack", "--plugin-path", "a", "plugins"]).plugin_path, [PathBuf::from("a")]);
    }
}
