//! The site's files, and the site in one file.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin::{Host, OutputFile, PluginError};

use crate::pictures::Picture;

/// What the page reads first.
pub const PREVIEW_JSON: &str = "stack/preview.json";
const INDEX: &str = include_str!("../../../web/dist/index.html");
const SCRIPT: &str = include_str!("../../../web/dist/viewer.js");
const STYLE: &str = include_str!("../../../web/dist/viewer.css");
const MODULE: &[u8] = include_bytes!("../../../web/dist/lumistack_web_bg.wasm");

/// What of the page is replaced in the single file.
const STYLE_LINK: &str = r#"<link rel="stylesheet" href="app/viewer.css">"#;
const SCRIPT_LINK: &str = r#"<script type="module" src="app/viewer.js"></script>"#;

/// A site that is being written.
pub(crate) struct Site<'a> {
    host: &'a Host,
    folder: String,
    /// Path and bytes of every picture, for the single file.
    pictures: Vec<(String, Vec<u8>)>,
}

impl<'a> Site<'a> {
    /// `folder` is empty or ends with `/`.
    pub(crate) fn new(host: &'a Host, folder: String) -> Self {
        Self { host, folder, pictures: Vec::new() }
    }

    /// Writes a picture; gives its entry in preview.json.
    pub(crate) fn picture(
        &mut self,
        path: &str,
        mut entry: Value,
        picture: &Picture,
        bytes: &[u8],
    ) -> Result<Value, PluginError> {
        self.host.write(&format!("{}{path}", self.folder), bytes)?;
        for (key, value) in [
            ("path", json!(path)),
            ("rows", json!(picture.rows)),
            ("cols", json!(picture.cols)),
            ("bytes", json!(bytes.len())),
        ] {
            entry[key] = value;
        }
        self.pictures.push((path.into(), bytes.to_vec()));
        Ok(entry)
    }

    /// Writes the page and preview.json.
    pub(crate) fn finish(self, title: &str, preview_json: &str, single_file: bool) -> Result<(), PluginError> {
        let index = titled(title);
        for (path, bytes) in [
            ("index.html", index.as_bytes()),
            ("app/viewer.js", SCRIPT.as_bytes()),
            ("app/viewer.css", STYLE.as_bytes()),
            ("app/lumistack_web_bg.wasm", MODULE),
            (PREVIEW_JSON, preview_json.as_bytes()),
        ] {
            self.host.write(&format!("{}{path}", self.folder), bytes)?;
        }
        if single_file { self.single_file(&index, preview_json) } else { Ok(()) }
    }

    fn single_file(&self, index: &str, preview_json: &str) -> Result<(), PluginError> {
        let parts = index
            .split_once(STYLE_LINK)
            .and_then(|(head, rest)| rest.split_once(SCRIPT_LINK).map(|(middle, end)| [head, middle, end]));
        let Some([head, middle, end]) = parts else {
            let text = "web/dist/index.html: expected links to app/viewer.css and, after it, app/viewer.js, found none";
            return Err(PluginError::Failed(text.into()));
        };
        let mut file = self.host.create(&format!("{}preview.html", self.folder))?;
        file.append(format!("{head}<style>{STYLE}</style>{middle}<script>window.LUMISTACK_INLINE={{").as_bytes())?;
        let fixed = [("wasm", MODULE), (PREVIEW_JSON, preview_json.as_bytes())];
        let pictures = self.pictures.iter().map(|(path, bytes)| (path.as_str(), bytes.as_slice()));
        for (i, (key, bytes)) in fixed.into_iter().chain(pictures).enumerate() {
            entry(&mut file, i, key, bytes)?;
        }
        file.append(b"};</script><script type=\"module\">")?;
        file.append(SCRIPT.as_bytes())?;
        file.append(format!("</script>{end}").as_bytes())?;
        file.commit()
    }
}

/// One picture of the single file. Keys are our own paths and base64 has nothing that a script would take for its end.
fn entry(file: &mut OutputFile, number: usize, key: &str, bytes: &[u8]) -> Result<(), PluginError> {
    let comma = if number == 0 { "" } else { "," };
    file.append(format!("{comma}\"{key}\":\"{}\"", STANDARD.encode(bytes)).as_bytes())
}

/// The page under a title.
fn titled(title: &str) -> String {
    let escaped = title.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    match (INDEX.find("<title>"), INDEX.find("</title>")) {
        (Some(start), Some(end)) if start < end => {
            format!("{}{escaped} – Lumistack{}", &INDEX[..start + "<title>".len()], &INDEX[end..])
        }
        _ => INDEX.into(),
    }
}
