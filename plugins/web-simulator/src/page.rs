//! Writes the site as a folder of files and, if requested, as one file that contains the page and
//! its pictures.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lumistack_plugin::serde_json::{Value, json};
use lumistack_plugin::{Host, OutputFile, PluginError};

use crate::pictures::Picture;
use crate::poster::{POSTER, Poster};

/// Path of the file that the page reads first.
pub const PREVIEW_JSON: &str = "stack/preview.json";
const INDEX: &str = include_str!("../dist/index.html");
const SCRIPT: &str = include_str!("../dist/viewer.js");
/// Scripts that the page loads only for headsets, lenticular displays and their software. The
/// single file does not contain them.
const OTHERS: [(&str, &str); 3] = [
    ("app/bridge.js", include_str!("../dist/bridge.js")),
    ("app/headset.js", include_str!("../dist/headset.js")),
    ("app/lenticular.js", include_str!("../dist/lenticular.js")),
];
const MODULE: &[u8] = include_bytes!("../dist/lumistack_web_bg.wasm");

/// The link to the script, which the single file replaces by the script itself.
const SCRIPT_LINK: &str = r#"<script type="module" src="app/viewer.js"></script>"#;
/// Marks around the page's title and description, which are replaced in every site.
const HEAD: [&str; 2] = ["<title>", "<!--/about-->"];
/// Mark that every site replaces by its poster.
const POSTER_PLACE: &str = "<!--poster-->";
/// Marks around the part of the page about the folder, which is removed from the single file.
const FOLDER: [&str; 2] = ["<!--folder-->", "<!--/folder-->\n"];
/// Marks around the part of the page about the single file. The part is removed from the single
/// file itself, and from the page if there is no single file.
const SINGLE: [&str; 2] = ["<!--single-->", "<!--/single-->"];
/// Number of bytes that are encoded together. It is a multiple of 3, so that the encoded pieces
/// together are the encoding of the whole file.
const ENCODED_AT_ONCE: usize = 3 << 16;

/// A site that is being written.
pub(crate) struct Site<'a> {
    host: &'a Host,
    folder: String,
    index: String,
    single: Option<SingleFile>,
}

/// The site in one file. Every picture is appended as soon as it is made, so that no picture is
/// kept in memory.
struct SingleFile {
    file: OutputFile,
    /// Number of bytes written so far.
    length: usize,
    /// Largest allowed number of bytes.
    most: usize,
    /// The part of the page after the files: its script, and the text after the script.
    end: String,
}

/// The texts and the poster of the page. Other sites show them in a preview of a link to the page.
pub(crate) struct About<'a> {
    pub(crate) title: &'a str,
    pub(crate) caption: &'a str,
    /// Address of the site; empty if unknown.
    pub(crate) address: &'a str,
    pub(crate) poster: &'a Poster,
}

impl<'a> Site<'a> {
    /// Begins a site in `folder`, which is empty or ends with `/`. `most_bytes` is the largest size
    /// of the single file; with `None`, no single file is written.
    pub(crate) fn new(
        host: &'a Host,
        folder: String,
        about: &About<'_>,
        most_bytes: Option<usize>,
    ) -> Result<Self, PluginError> {
        let single = match most_bytes {
            Some(most) => Some(SingleFile::new(host, &folder, about, most)?),
            None => None,
        };
        let mut site = Self { host, folder, index: about.page(false)?, single };
        site.file(POSTER, &about.poster.jpeg)?;
        Ok(site)
    }

    /// Writes a file of the site. If the site is also written as a single file, appends the file to
    /// the single file too. A single file that would become too large is removed.
    pub(crate) fn file(&mut self, path: &str, bytes: &[u8]) -> Result<(), PluginError> {
        self.host.write(&format!("{}{path}", self.folder), bytes)?;
        let Some(single) = &mut self.single else { return Ok(()) };
        if single.add(path, bytes)? {
            return Ok(());
        }
        // Drop the open single file, which removes it.
        let most = single.most as f64 / 1e6;
        self.single = None;
        let text = format!(
            "preview.html was left out, since the file would have more than {most} MB (single_file_mb). `lumistack preview` on the output's folder shows the page."
        );
        self.host.info(&text);
        Ok(())
    }

    /// Writes a picture; returns `entry` with its path and sizes, for preview.json.
    pub(crate) fn picture(
        &mut self,
        path: &str,
        mut entry: Value,
        picture: &Picture,
        bytes: &[u8],
    ) -> Result<Value, PluginError> {
        self.file(path, bytes)?;
        for (key, value) in [
            ("path", json!(path)),
            ("rows", json!(picture.rows)),
            ("cols", json!(picture.cols)),
            ("bytes", json!(bytes.len())),
        ] {
            entry[key] = value;
        }
        Ok(entry)
    }

    /// Writes preview.json and the page.
    pub(crate) fn finish(mut self, preview_json: &str) -> Result<(), PluginError> {
        self.file(PREVIEW_JSON, preview_json.as_bytes())?;
        let index = if self.single.is_some() { self.index.clone() } else { cut(&self.index, SINGLE, "")? };
        let own = [
            ("index.html", index.as_bytes()),
            ("app/viewer.js", SCRIPT.as_bytes()),
            ("app/lumistack_web_bg.wasm", MODULE),
        ];
        for (path, bytes) in own.into_iter().chain(OTHERS.map(|(path, script)| (path, script.as_bytes()))) {
            self.host.write(&format!("{}{path}", self.folder), bytes)?;
        }
        self.single.map_or(Ok(()), SingleFile::finish)
    }
}

impl SingleFile {
    fn new(host: &Host, folder: &str, about: &About<'_>, most: usize) -> Result<Self, PluginError> {
        let index = about.page(true)?;
        let Some((start, end)) = index.split_once(SCRIPT_LINK) else {
            let text = "web/dist/index.html: expected a link to app/viewer.js, found none";
            return Err(PluginError::Failed(text.into()));
        };
        let file = host.create(&format!("{folder}preview.html"))?;
        let end = format!("}};</script><script type=\"module\">{SCRIPT}</script>{end}");
        let mut single = Self { file, length: 0, most, end };
        single.text(&format!("{start}<script>window.LUMISTACK_INLINE={{"))?;
        single.entry("wasm", MODULE)?;
        Ok(single)
    }

    /// Appends a file of the site; returns false if the single file would be too large.
    fn add(&mut self, path: &str, bytes: &[u8]) -> Result<bool, PluginError> {
        // A comma, two pairs of quotes and a colon surround the path and the bytes as base64.
        let added = path.len() + bytes.len().div_ceil(3) * 4 + 6;
        if self.length + added + self.end.len() > self.most {
            return Ok(false);
        }
        self.text(",")?;
        self.entry(path, bytes)?;
        Ok(true)
    }

    /// Appends a file to the JSON object in the page, with its path as the key and its bytes as
    /// base64. Paths of this crate and base64 have no special characters, so nothing needs escapes.
    fn entry(&mut self, key: &str, bytes: &[u8]) -> Result<(), PluginError> {
        self.text(&format!("\"{key}\":\""))?;
        for part in bytes.chunks(ENCODED_AT_ONCE) {
            self.text(&STANDARD.encode(part))?;
        }
        self.text("\"")
    }

    fn finish(mut self) -> Result<(), PluginError> {
        let end = std::mem::take(&mut self.end);
        self.text(&end)?;
        self.file.commit()
    }

    fn text(&mut self, text: &str) -> Result<(), PluginError> {
        self.length += text.len();
        self.file.append(text.as_bytes())
    }
}

impl About<'_> {
    /// Returns the page's HTML. If `single`, the HTML contains the poster, and refers only to the
    /// script and preview.json, which the single file will contain.
    fn page(&self, single: bool) -> Result<String, PluginError> {
        let Poster { jpeg, rows, cols } = self.poster;
        let source = if single { format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg)) } else { POSTER.into() };
        let image = format!(
            r#"<img slot="poster" src="{source}" width="{cols}" height="{rows}" fetchpriority="high" alt="{}">"#,
            escaped(self.title)
        );
        let page = cut(INDEX, HEAD, &self.head(single))?;
        let page = cut(&page, [POSTER_PLACE, ""], &image)?;
        if single { cut(&cut(&page, FOLDER, "")?, SINGLE, "") } else { Ok(page) }
    }

    /// Returns the HTML of the page's title and description. The HTML also states both as
    /// properties (Open Graph) that services read for the preview of a link.
    fn head(&self, single: bool) -> String {
        let (title, caption) = (escaped(self.title), escaped(self.caption));
        let mut head = format!(
            "<title>{title} – Lumistack</title>\n<meta name=\"description\" content=\"{caption}\">\n\
             <meta property=\"og:type\" content=\"website\">\n<meta property=\"og:title\" content=\"{title}\">\n\
             <meta property=\"og:description\" content=\"{caption}\">\n"
        );
        if !single {
            let address = escaped(self.address.trim_end_matches('/'));
            let base = if address.is_empty() { String::new() } else { format!("{address}/") };
            let Poster { rows, cols, .. } = self.poster;
            if !base.is_empty() {
                head += &format!("<meta property=\"og:url\" content=\"{base}\">\n");
            }
            head += &format!(
                "<meta property=\"og:image\" content=\"{base}{POSTER}\">\n<meta property=\"og:image:width\" content=\"{cols}\">\n\
                 <meta property=\"og:image:height\" content=\"{rows}\">\n<meta name=\"twitter:card\" content=\"summary_large_image\">"
            );
        }
        head
    }
}

/// Replaces two marks of a page, and the part between them, by `text`.
fn cut(page: &str, [from, to]: [&str; 2], text: &str) -> Result<String, PluginError> {
    let missing = |mark: &str| PluginError::Failed(format!("web/dist/index.html: expected {mark}, found none"));
    let start = page.find(from).ok_or_else(|| missing(from))?;
    let after = start + from.len();
    let end = after + page[after..].find(to).ok_or_else(|| missing(to))? + to.len();
    Ok(format!("{}{text}{}", &page[..start], &page[end..]))
}

/// Escapes text for HTML, also for use within double quotes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
