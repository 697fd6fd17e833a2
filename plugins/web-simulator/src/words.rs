//! Makes texts about a display, for the page and for previews of links to the page.

use lumistack_plugin::display::{Backlight, Display};

/// Returns a title for users. A name that looks like the name of a file becomes words ("still-life"
/// → "Still life"). Other names are unchanged.
pub(crate) fn title_of(name: &str) -> String {
    let of_file = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    let words = name.split(['-', '_']).filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
    if words.is_empty() || !name.chars().all(of_file) {
        return name.into();
    }
    words[..1].to_uppercase() + &words[1..]
}

/// Returns two sentences that describe the scene and the display.
pub(crate) fn caption_of(title: &str, display: &Display) -> String {
    let plural = |count: usize, one: &str| match count {
        1 => format!("one {one}"),
        count => format!("{} {one}s", in_words(count)),
    };
    let layers = plural(display.layers.len(), "layer");
    let below = if matches!(display.backlight, Backlight::Lenslets(_)) { " over a directional backlight" } else { "" };
    let frames = match display.frames {
        1 => String::new(),
        count => format!(", and shows {} frames in quick succession", in_words(count)),
    };
    let half = 0.5 * display.field.fov_deg[0].max(display.field.fov_deg[1]);
    let half = (10.0 * half).round() / 10.0;
    format!(
        "{title} in 3D without glasses, within {half}° of straight ahead. The display has {layers} of pixels{below}{frames}."
    )
}

fn in_words(count: usize) -> String {
    const WORDS: [&str; 13] =
        ["no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"];
    WORDS.get(count).map_or_else(|| count.to_string(), |word| (*word).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_become_words_and_titles_stay() {
        for (name, title) in [
            ("still-life", "Still life"),
            ("my_scene-2", "My scene 2"),
            ("FlightHelmet", "FlightHelmet"),
            ("A <b> & c", "A <b> & c"),
            ("", ""),
            ("-_-", "-_-"),
            ("été", "été"),
        ] {
            assert_eq!(title_of(name), title);
        }
    }

    #[test]
    fn a_caption_counts_layers_and_frames() {
        let display = Display::uniform([6, 5], 1.0, [3, 3], [20.0, 20.0], &[-3.0, 0.0, 3.0], 6);
        assert_eq!(
            caption_of("Still life", &display),
            "Still life in 3D without glasses, within 10° of straight ahead. The display has three layers of pixels, and shows six frames in quick succession."
        );
        let display = Display::uniform([6, 5], 1.0, [3, 3], [25.0, 10.0], &[0.0], 1);
        assert_eq!(
            caption_of("X", &display),
            "X in 3D without glasses, within 12.5° of straight ahead. The display has one layer of pixels."
        );
    }
}
