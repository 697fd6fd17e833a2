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
/// Bytes; a multiple of 3, so that the parts' texts join to the text of the whole.
const ENCODED_AT_ONCE: usize = 3 << 16;

/// A site that is being written.
pub(crate) struct Site<'a> {
    host: &'a Host,
    folder: String,
    index: String,
    single: Option<SingleFile>,
}

/// The site in one file; every picture is added when it is there, so that none is kept.
struct SingleFile {
    file: OutputFile,
    /// What of the page follows its script.
    end: String,
}

impl<'a> Site<'a> {
    /// `folder` is empty or ends with `/`.
    pub(crate) fn new(host: &'a Host, folder: String, title: &str, single_file: bool) -> Result<Self, PluginError> {
        let index = titled(title);
        let single = if single_file { Some(SingleFile::new(host, &folder, &index)?) } else { None };
        Ok(Self { host, folder, index, single })
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
        if let Some(single) = &mut self.single {
            single.text(",")?;
            single.entry(path, bytes)?;
        }
        Ok(entry)
    }

    /// Writes the page and preview.json.
    pub(crate) fn finish(self, preview_json: &str) -> Result<(), PluginError> {
        for (path, bytes) in [
            ("index.html", self.index.as_bytes()),
            ("app/viewer.js", SCRIPT.as_bytes()),
            ("app/viewer.css", STYLE.as_bytes()),
            ("app/lumistack_web_bg.wasm", MODULE),
            (PREVIEW_JSON, preview_json.as_bytes()),
        ] {
            self.host.write(&format!("{}{path}", self.folder), bytes)?;
        }
        self.single.map_or(Ok(()), |single| single.finish(preview_json))
    }
}

impl SingleFile {
    fn new(host: &Host, folder: &str, index: &str) -> Result<Self, PluginError> {
        let parts = index
            .split_once(STYLE_LINK)
            .and_then(|(head, rest)| rest.split_once(SCRIPT_LINK).map(|(middle, end)| [head, middle, end]));
        let Some([head, middle, end]) = parts else {
            let text = "web/dist/index.html: expected links to app/viewer.css and, after it, app/viewer.js, found none";
            return Err(PluginError::Failed(text.into()));
        };
        let file = host.create(&format!("{folder}preview.html"))?;
        let mut single = Self { file, end: end.into() };
        single.text(&format!("{head}<style>{STYLE}</style>{middle}<script>window.LUMISTACK_INLINE={{"))?;
        single.entry("wasm", MODULE)?;
        Ok(single)
    }

    /// A file of the site. Keys are our own paths and base64 has nothing that a script would take for its end.
    fn entry(&mut self, key: &str, bytes: &[u8]) -> Result<(), PluginError> {
        self.text(&format!("\"{key}\":\""))?;
        for part in bytes.chunks(ENCODED_AT_ONCE) {
            self.text(&STANDARD.encode(part))?;
        }
        self.text("\"")
    }

    fn finish(mut self, preview_json: &str) -> Result<(), PluginError> {
        self.text(",")?;
        self.entry(PREVIEW_JSON, preview_json.as_bytes())?;
        self.text("};</script><script type=\"module\">")?;
        self.text(SCRIPT)?;
        let end = format!("</script>{}", self.end);
        self.text(&end)?;
        self.file.commit()
    }

    fn text(&mut self, text: &str) -> Result<(), PluginError> {
        self.file.append(text.as_bytes())
    }
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
