//! Writes the page. For each file it has a row of three pictures, the scores, and a sentence that
//! explains differences.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lumistack_core::tone::ToneCurve;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::Value;

use crate::compare::{self, Halves, ToneMapping};
use crate::{Outcome, text};

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:1320px;padding:0 1rem;color:#222;background:#fafafa}
section{margin:2.2rem 0;border-top:1px solid #ddd}h2{font-size:1.05rem;margin:.8rem 0 .4rem}
figure{margin:0;flex:1}figcaption{font-size:.85rem;color:#555}.row{display:flex;gap:8px}img{width:100%;display:block;background:#000}
p{margin:.4rem 0;max-width:75em}.figures{font-size:.85rem;color:#555}.message{background:#fff3d6;padding:.4rem .7rem}.none{color:#a00}
.warning{font-size:.85rem;color:#765}";

/// Notes on the files, from a TOML file.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Notes {
    /// Notes that apply to all pairs.
    general: Vec<String>,
    /// A note for each file, by the file's name.
    files: BTreeMap<String, String>,
}

/// Writes `index.html` and its pictures from the folders in `out`.
pub fn write(out: &Path, notes: &Path) -> Outcome {
    let source = std::fs::read_to_string(notes).map_err(|error| format!("{}: {error}", notes.display()))?;
    let notes: Notes = toml::from_str(&source).map_err(|error| format!("{}: {error}", notes.display()))?;
    // Folders without `ours.json` do not belong to this gallery.
    let mut folders: Vec<PathBuf> = std::fs::read_dir(out).map_err(text)?.flatten().map(|entry| entry.path()).collect();
    folders.retain(|folder| folder.join("ours.json").is_file());
    folders.sort();
    // One section per file, in the order of their names.
    let mut sections = Vec::new();
    for folder in &folders {
        sections.push(section(out, folder, &notes)?);
    }
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { "Gallery" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Every glTF and USD file, our render next to the render of Blender's Cycles" }
                @for note in &notes.general { p { (note) } }
                @for section in &sections { (section) }
            }
        }
    };
    let path = out.join("index.html");
    std::fs::write(&path, page.into_string()).map_err(text)?;
    println!("{} files: {}", folders.len(), path.display());
    Ok(())
}

fn section(out: &Path, folder: &Path, notes: &Notes) -> Outcome<Markup> {
    let load = |name: &str| -> Option<Value> { serde_json::from_slice(&std::fs::read(folder.join(name)).ok()?).ok() };
    let ours = load("ours.json").ok_or_else(|| format!("{}: ours.json is damaged", folder.display()))?;
    let name = ours["name"].as_str().unwrap_or_default();
    let blender = load("blender.json");
    let note = notes.files.get(name);
    let body = match ours["error"].as_str() {
        Some(message) => html! { p.message { (message) } },
        None => pair(out, folder, &ours, blender.as_ref())?,
    };
    let warnings: Vec<&str> = ours["warnings"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    // The heading names the file, so warnings leave its path out.
    let prefix = format!("{}: ", ours["path"].as_str().unwrap_or_default());
    Ok(html! {
        section id=(name) {
            h2 { (name) }
            (body)
            @match note {
                Some(note) => p { (note) },
                None => p.none { "No note explains the differences yet." },
            }
            @for warning in warnings { p.warning { "Warning: " (warning.strip_prefix(&prefix).unwrap_or(warning)) } }
        }
    })
}

/// Writes the three pictures of a file next to the page. Returns them with captions and scores.
fn pair(out: &Path, folder: &Path, ours: &Value, blender: Option<&Value>) -> Outcome<Markup> {
    let stem = folder.file_name().unwrap_or_default().to_string_lossy();
    let save = |picture: image::RgbImage, kind: &str| -> Outcome<String> {
        let relative = format!("pictures/{stem}-{kind}.png");
        std::fs::create_dir_all(out.join("pictures")).map_err(text)?;
        picture.save(out.join(&relative)).map_err(text)?;
        Ok(relative)
    };
    let seconds = |about: &Value, key: &str| format!("{:.1} s", about[key].as_f64().unwrap_or(f64::NAN));
    // All three pictures have the exposure and tone curve of our picture.
    let halves = Halves::read(folder, "ours", "covered-ours.npy")?;
    let curve = ToneCurve::ALL.iter().find(|(name, _)| ours["curve"] == *name);
    let (_, curve) = *curve.ok_or_else(|| format!("{}: ours.json names no tone curve", folder.display()))?;
    let tone_mapping = ToneMapping { exposure: ours["exposure"].as_f64().unwrap_or(1.0), curve };
    let own = save(halves.shown(&tone_mapping), "ours")?;
    let caption = format!(
        "Lumistack: {} samples, rendered in {}, loaded in {}",
        ours["samples"],
        seconds(ours, "seconds_render"),
        seconds(ours, "seconds_load")
    );
    // Without Blender's render, the row has only our picture.
    let missing = match blender {
        None => Some("Not rendered.".to_owned()),
        Some(about) => about["error"].as_str().map(|message| format!("Blender: {message}")),
    };
    if let Some(missing) = missing {
        return Ok(html! {
            .row { (figure(&own, &caption)) figure { p.message { (missing) } } figure {} }
        });
    }
    // Write both pictures, their difference, and a line of scores.
    let about = blender.unwrap_or(&Value::Null);
    let other = Halves::read(folder, "blender", "covered.npy")?;
    let theirs = save(other.shown(&tone_mapping), "blender")?;
    let differs = save(compare::difference(&halves, &other, &tone_mapping), "difference")?;
    let figures = compare::figures(&halves, &other);
    let theirs_caption = format!(
        "Blender {}: {} samples, {}",
        about["blender"].as_str().unwrap_or("?"),
        ours["samples"],
        seconds(about, "seconds_render")
    );
    let line = format!(
        "Our mean divided by Blender's, for red, green, blue, where there is a surface: {:.3}, {:.3}, {:.3}. Difference without noise: {:.1} % of the mean \
         (with noise {:.1} %). Silhouettes overlap to {:.2} %, shifted by {:.2}, {:.2} pixels. Exposure {:.3}, curve {}, {} triangles.",
        figures.ratio[0],
        figures.ratio[1],
        figures.ratio[2],
        100.0 * figures.difference,
        100.0 * figures.with_noise,
        100.0 * figures.overlap,
        figures.shift[0],
        figures.shift[1],
        tone_mapping.exposure,
        tone_mapping.curve.name(),
        ours["triangles"],
    );
    // The line of scores also appears in the log, so that runs can be compared without a browser.
    println!("{}: {line}", ours["name"].as_str().unwrap_or_default());
    let gain =
        format!("{} × luminance difference: orange where ours is brighter, blue where Blender's is", compare::GAIN);
    Ok(html! {
        .row { (figure(&own, &caption)) (figure(&theirs, &theirs_caption)) (figure(&differs, &gain)) }
        p.figures { (line) }
    })
}

fn figure(picture: &str, caption: &str) -> Markup {
    html! {
        figure {
            a href=(picture) { img src=(picture) alt=(caption); }
            figcaption { (caption) }
        }
    }
}
