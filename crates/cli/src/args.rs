//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};

use crate::groups::{
    DisplayArgs, FactorizeArgs, FactorizeDisplayArgs, FieldLookArgs, FileArgs, GeometryArgs, JobArgs, RenderArgs,
};
use crate::values::Numbers;

/// Turn 3D scenes into glasses-free 3D: path-trace the light field of a scene and factorize it
/// into the layer patterns of a tensor display.
#[derive(Debug, Parser)]
#[command(name = "lumistack", version, max_term_width = 110, args_override_self = true)]
pub(crate) struct Args {
    /// Print the causes of errors
    #[arg(short, long, global = true)]
    pub(crate) verbose: bool,
    /// Print progress and results as JSON, one object a line
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Worker threads; results do not depend on their number [default: all cores]
    #[arg(long, global = true, value_name = "N")]
    pub(crate) threads: Option<usize>,
    /// A plugin, or a folder of plugins (shared libraries `lumistack_plugin_ID`). It takes
    /// precedence over LUMISTACK_PLUGIN_PATH and over lumistack/plugins in your data folder. The
    /// flag may be given several times
    #[cfg(feature = "dynamic")]
    #[arg(long, global = true, value_name = "FILE|DIR")]
    pub(crate) plugin_path: Vec<PathBuf>,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run a job or a scene from the views to the outputs: render, factorize, write, report
    #[command(
        after_help = "Examples:\n  lumistack run scenes/still-life/job.toml\n  lumistack run scenes/still-life/job.toml --plan        its steps, which of them are cached, estimated time and memory\n  lumistack run model.glb --display paper-three-layer -o runs/model\n  lumistack run model.glb --times 24 --turn-deg 30 -o runs/walk        a sequence: a run folder per time step, and a report of error and flicker\n  lumistack run fox.glb --animation Walk --times 24 --duration-s 0.7 -o runs/fox      the scene's animation plays\n\nA scene without a job file gets pictures and the browser simulator as outputs. The same command continues a run that was stopped."
    )]
    Run(Run),
    /// Write a commented job file from three answers: scene, display, outputs
    #[command(after_help = crate::new::EXAMPLES)]
    New(crate::new::New),
    /// Render only the views of a scene, into a light-field folder
    #[command(
        after_help = "Examples:\n  lumistack render model.glb -o views                                    all views of the display, exposed and tone-mapped\n  lumistack render model.glb --linear --layers depth,normal -o views     scene-linear radiance, with depth and normals\n  lumistack render model.glb --views 7x7 --only-views 3,* -o row         the middle one of seven rows of views\n\nViews are OpenEXR pictures; lightfield.json states the geometry of their rays. `lumistack factorize DIR -o RUN` reads the folder."
    )]
    Render(Render),
    /// Make layer patterns from a given light field, for example one that another program rendered
    #[command(
        after_help = "Reads our own light-field folders, HCI and Stanford folders, quilts and .npy arrays [view_y][view_x][row][col][rgb].\n\nExamples:\n  lumistack factorize views.npy --grid oblique --fov 20x20 --pitch-mm 2.961 --display paper-three-layer -o runs/views\n  lumistack factorize times/ --sequence --fov 20x20 --pitch-mm 2.961 -o runs/times      times/t0001.npy, times/t0002.npy, ..."
    )]
    Factorize(Factorize),
    /// Write the picture that the display of a finished run shows, seen from a direction or
    /// position
    #[command(
        after_help = "Examples:\n  lumistack simulate runs/still-life --view 4,-2 -o view.png      4° from the right, 2° from below\n  lumistack simulate runs/still-life --eye 100,0,2000 -o eye.png  an eye 2 m in front, 100 mm to the right\n  lumistack simulate runs/still-life --sweep 7 -o strip.png       seven views from left to right"
    )]
    Simulate(Simulate),
    /// Open the browser simulator: look at the display of a finished run from anywhere
    #[command(
        after_help = "Examples:\n  lumistack preview runs/still-life     the run's patterns\n  lumistack preview --solve             a page that solves: drop a model there\n\nIt serves this machine alone, opens the browser, and reloads the page when the patterns change. A preview folder also works on any\nweb server as it is; its preview.html opens by a double click."
    )]
    Preview(Preview),
    /// Analyze displays by their geometry: depth of field, spectral support, viewing zone, frame
    /// rate, brightness
    #[command(after_help = crate::analyze::EXAMPLES)]
    Analyze(crate::analyze::Analyze),
    /// Compare many designs on one light field by PSNR and brightness, in a table and plots. With
    /// constraints, propose the design to build
    #[command(after_help = crate::sweep::EXAMPLES)]
    Sweep(crate::sweep::Sweep),
    /// Run a job or a sweep on many machines: by Dask, or as a job for a farm manager
    #[command(after_help = crate::farm::EXAMPLES)]
    Farm(Box<crate::farm::Farm>),
    /// Compare two runs, or a run with a photograph of its panels. With --focus also write the
    /// pictures of an eye that focuses at given distances
    #[command(after_help = crate::compare::EXAMPLES)]
    Compare(crate::compare::Compare),
    /// Drive physical panels: every layer on its output, frame after frame
    #[command(
        after_help = "Examples:\n  lumistack show --list                                          outputs and their names\n  lumistack show runs/still-life                                 one surface per output\n  lumistack show my-display.toml --pattern crosshairs --only 1   for aligning a stack\n  lumistack show runs/still-life --preview                       no panels: a preview in a window, the mouse moves the viewer\n\nKeys: space holds a frame or resumes, comma and full stop show the previous and the next frame, Tab selects a panel, arrows shift it,\ns saves the shifts, r reports, q ends. In a preview the arrows turn the view.\n\nNew patterns replace the shown ones at the end of a period, after all frames. docs/PANELS.md explains how to build and calibrate a stack."
    )]
    Show(Box<crate::show::Show>),
    /// Show a display that follows its scene while settings, files, time and viewers change
    #[command(after_help = crate::live::EXAMPLES)]
    Live(Box<crate::live::Live>),
    /// Print the contents of a scene, a light field, a layer stack, a run folder, a display or a
    /// job
    Info(Info),
    /// Remove files that were left in a run folder by runs that were stopped, and cached results
    /// that the last run did not use. The results of the last run stay
    #[command(
        after_help = "Examples:\n  lumistack clean runs/still-life --dry-run     sizes of the files that would be removed, by kind\n  lumistack clean runs/*                        every run, sequence and sweep\n  lumistack clean runs/still-life --all         also all cached views: the next run with other settings renders them again"
    )]
    Clean(Clean),
    /// List all plugins with their parameters and files, and the libraries that could not be loaded
    #[command(
        after_help = "Example:\n  lumistack plugins tensor-display      one plugin, with the values that its parameters take"
    )]
    Plugins {
        /// Only these plugins
        #[arg(value_name = "ID")]
        ids: Vec<String>,
    },
    /// List the graphics processors that can solve, and the one that `--device auto` uses
    Devices,
    /// List the presets of displays
    Displays,
    /// Write a display file for your own panels, or calibrate it
    Display {
        #[command(subcommand)]
        what: crate::display::DisplayCommand,
    },
    /// Report which optional software and hardware this machine has, and how to get the rest
    #[command(after_help = crate::doctor::EXAMPLES)]
    Doctor,
    /// Install optional software that some files need
    Setup {
        #[command(subcommand)]
        what: Setup,
    },
    /// Print the JSON Schema of job or display files; editors use it to complete and check keys
    #[command(
        after_help = "Example:\n  lumistack schema display > display.schema.json\n\nEditors that use taplo (Even Better TOML and others) read it if the file's first line is `#:schema ./display.schema.json`. The schema of jobs\nhas the parameters of all plugins that are found."
    )]
    Schema {
        /// Kind of file
        what: Schema,
    },
    /// Print a shell's completions
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
    /// It is not needed if a Python of yours has the package usd-core. The program tries the Python
    /// of the active virtual environment, the one that LUMISTACK_PYTHON names, and the one on PATH.
    Usd {
        /// Install usd-exchange instead of usd-core: its OpenUSD also reads MaterialX files (.mtlx)
        #[arg(long)]
        materialx: bool,
        /// Python to make the environment with [default: python3 on PATH]
        #[arg(long, value_name = "PROGRAM")]
        python: Option<PathBuf>,
    },
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Run {
    /// Job file (.toml) or scene (.gltf, .glb, USD, or a file of an importer plugin)
    pub(crate) input: PathBuf,
    /// Print the steps of the run with their keys, cached results, and estimates of time and
    /// memory, without running it
    #[arg(long)]
    pub(crate) plan: bool,
    #[command(flatten)]
    pub(crate) job: JobArgs,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Render {
    /// Scene (.gltf, .glb, USD, or a file of an importer plugin) or job file (.toml)
    pub(crate) scene: PathBuf,
    /// Folder for the views
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// Write scene-linear radiance as 32-bit OpenEXR: neither exposed nor tone-mapped nor clipped
    #[arg(long, help_heading = "Views", conflicts_with_all = ["exposure_ev", "tone", "background"])]
    pub(crate) linear: bool,
    /// Data of the visible surfaces, written into a file layers_YY_XX.exr per view. LIST has some
    /// of these, separated by commas: depth (millimetres in front of the display plane), normal,
    /// albedo, variance, coverage
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Views")]
    pub(crate) layers: Vec<lumistack_pipeline::ExtraChannel>,
    /// Render these views only, ROW,COL as in view_ROW_COL.exr. Each is a number from 0, a range
    /// such as 0..2, or *; the flag may be given several times
    #[arg(long, value_name = "ROW,COL", help_heading = "Views")]
    pub(crate) only_views: Vec<lumistack_pipeline::ViewSelection>,
    #[command(flatten)]
    pub(crate) display: DisplayArgs,
    #[command(flatten)]
    pub(crate) render: RenderArgs,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Factorize {
    /// Light field: a folder, a quilt or .npy; with --sequence a folder of light fields
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
    /// Seed of all random streams
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Read the folder as a sequence: one light field per time step, folders or .npy files in the
    /// order of their names
    #[arg(long, help_heading = "Sequence")]
    pub(crate) sequence: bool,
    /// Iterations at every time step after the first [default: 5]
    #[arg(long, value_name = "N", requires = "sequence", help_heading = "Sequence")]
    pub(crate) sequence_iterations: Option<u32>,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Simulate {
    /// A run folder
    pub(crate) dir: PathBuf,
    /// Direction from the display to the eye, which is far away (a parallel projection): X to the
    /// right, Y up, degrees [default: 0,0]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, conflicts_with_all = ["eye", "sweep"])]
    pub(crate) view: Option<Numbers<2>>,
    /// Eye position from the display's centre: X right, Y up, Z in front, millimetres; a
    /// perspective view
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "sweep")]
    pub(crate) eye: Option<Numbers<3>>,
    /// Write a film strip of this many views across the horizontal field of view
    #[arg(long, value_name = "N")]
    pub(crate) sweep: Option<usize>,
    /// Write the emitted light itself, not the seen picture (emitted / β)
    #[arg(long)]
    pub(crate) raw: bool,
    /// Picture to write: .png (sRGB-encoded) or .exr (linear)
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: PathBuf,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Clean {
    /// Folders of runs, sequences, sweeps or rendered views
    #[arg(required = true, value_name = "RUN")]
    pub(crate) dirs: Vec<PathBuf>,
    /// Also remove all cached views; they only save time at the next run
    #[arg(long)]
    pub(crate) all: bool,
    /// Report what would be removed, but remove nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Preview {
    /// A run folder, or a preview that the output plugin `web_simulator` wrote
    #[arg(required_unless_present = "solve")]
    pub(crate) dir: Option<PathBuf>,
    /// Serve the page that solves: drop a model there, and watch its patterns form
    #[arg(long, conflicts_with = "dir")]
    pub(crate) solve: bool,
    /// Port; 0 for any free port
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub(crate) port: u16,
    /// Do not open the browser
    #[arg(long)]
    pub(crate) no_open: bool,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct Info {
    /// The file or folder, or the name of a display preset
    pub(crate) file: PathBuf,
    /// For a scene or a job: compare its depth with the depth of field of this display, a preset or
    /// a display file
    #[arg(long, value_name = "NAME|FILE", help_heading = "Depth")]
    pub(crate) display: Option<OsString>,
    /// Camera, by name or number; its plane of focus becomes the display plane
    #[arg(long, value_name = "NAME|N", requires = "display", help_heading = "Depth")]
    pub(crate) camera: Option<String>,
    /// View the scene from this azimuth and elevation, degrees
    #[arg(long, value_name = "AZ,EL", allow_hyphen_values = true, requires = "display", help_heading = "Depth")]
    pub(crate) look_from: Option<Numbers<2>>,
    /// Bring the scene into the display's depth of field: auto, off, move or compress. With move,
    /// the window moves along its normal. With compress, it moves, and depth is compressed if the
    /// scene still does not fit. Auto acts as compress if the scene does not fit. Without HOW: move
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
