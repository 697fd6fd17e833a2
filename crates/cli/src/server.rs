//! Serves the files of a folder on the loopback interface. Other machines cannot connect, and files
//! outside of the folder are not served.
//!
//! The server answers `GET` and `HEAD` only, and closes the connection after every response.
//!
//! Every connection has its own thread; there are at most [`MOST`] connections. A request has a
//! head of at most 16 KiB, received within 5 s, and no body. So a client that sends slowly or does
//! not read delays no other client. When there are too many connections, the oldest one without a
//! complete request is closed first.

use std::fs::File;
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use percent_encoding::percent_decode_str;

/// Path that the page requests to find out whether the stack has changed.
const STAMP: &str = "/.stamp";
/// Interval at which [`serve`] calls `tick`.
const TICK: Duration = Duration::from_millis(200);
/// Largest number of open connections; a browser opens six.
const MOST: usize = 64;
/// Time limit for a client to send the whole head of a request, even byte by byte.
const HEAD_TIME: Duration = Duration::from_secs(5);
/// Longest head of a request (its first line and header fields), bytes.
const HEAD: usize = 16 << 10;
/// Largest number of header fields in a request.
const FIELDS: usize = 64;
/// Time limit for a client to receive the next part of a response.
const WRITE_TIME: Duration = Duration::from_secs(10);
/// Size of the pieces in which a response is written, bytes.
const PART: usize = 64 << 10;
/// Time in which the bytes that follow a request are read and discarded. If a connection is closed
/// with unread bytes, the client may lose the response.
const LINGER: Duration = Duration::from_millis(500);

/// Script that checks once a second whether the folder has changed. If so, the script reloads the
/// page, which keeps its state in its address.
const RELOAD: &str = "<script>{const was='STAMP';setInterval(async()=>{try{\
    const answer=await fetch('.stamp',{cache:'no-store'});if(answer.ok&&await answer.text()!==was)location.reload()\
    }catch{}},1000)}</script></body>";

/// Returns the element that loads the script of a live display. The script receives new states
/// without a reload. With `word`, the script's address contains this secret, which a request must
/// contain to move the page's viewer. Pages of other origins cannot read the secret.
fn follow(word: Option<&str>) -> String {
    let query = word.map_or(String::new(), |word| format!("?viewer={word}"));
    format!("<script type=\"module\" src=\".live.js{query}\"></script></body>")
}

/// A socket that listens on the loopback interface.
pub(crate) struct Server {
    listener: TcpListener,
    address: SocketAddr,
}

/// Starts to listen; `port` 0 takes any free port.
pub(crate) fn listen(port: u16) -> io::Result<Server> {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
    let address = listener.local_addr()?;
    Ok(Server { listener, address })
}

/// Returns the port that a server listens on.
pub(crate) fn port_of(server: &Server) -> u16 {
    server.address.port()
}

/// The served content.
#[derive(Clone, Copy)]
pub(crate) struct Site<'a> {
    /// The folder of files.
    pub(crate) root: &'a Path,
    /// The states of a live display, and its script.
    pub(crate) live: Option<&'a dyn Feed>,
}

/// States of a display that changes.
pub(crate) trait Feed: Sync {
    /// Returns the script that requests states.
    fn script(&self) -> &'static str;
    /// Waits for a state or message that is newer than those in the query, or for a timeout.
    /// Returns the response, or `None` if nothing new came.
    fn frame(&self, query: &str) -> Option<Vec<u8>>;
    /// Returns the secret that a query of [`look`](Self::look) must contain. `None` if pages may
    /// not move a viewer.
    fn word(&self) -> Option<&str>;
    /// Moves the viewer of a page. Returns whether the query is valid.
    fn look(&self, query: &str) -> bool;
}

/// The element that preloads `stack/preview.json`, the index of the preview. The page of a live
/// display does not need it.
const PRELOAD: &str = "<link rel=\"preload\" as=\"fetch\" crossorigin href=\"stack/preview.json\">\n";
/// Path of the script of a live display.
const SCRIPT: &str = "/.live.js";
/// Path of the states that the script requests.
const STATES: &str = "/.live";
/// Path to which the script sends the position of the page's viewer.
const LOOK: &str = "/.look";
/// The beginning of the element that shows a preview. A live display replaces the first text, which
/// the page contains, by the second, which names no preview.
const ELEMENT: [&str; 2] = ["<lumistack-viewer src=\"stack/preview.json\"", "<lumistack-viewer"];

/// Serves requests until `tick` returns `None`. `tick` is called about five times a second, and
/// returns a text that changes when the folder changes.
pub(crate) fn serve(server: &Server, site: Site<'_>, mut tick: impl FnMut() -> Option<String>) {
    let (stop, open, stamp) = (AtomicBool::new(false), Connections::default(), Mutex::new(String::new()));
    let (stop, open, stamp) = (&stop, &open, &stamp);
    thread::scope(|scope| {
        scope.spawn(move || {
            loop {
                let accepted = server.listener.accept();
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                // Accepting fails if no file descriptors are left. Another connection may end
                // during this pause.
                let Ok((stream, _)) = accepted else {
                    thread::sleep(Duration::from_millis(50));
                    continue;
                };
                let Some(connection) = open.add(&stream) else { continue };
                let answer = move || {
                    let complete = || open.has_request(connection);
                    // A panic is caught, so that only the response to this request is lost.
                    let _ = catch_unwind(AssertUnwindSafe(|| answer(&stream, site, stamp, complete)));
                    open.remove(connection);
                };
                if thread::Builder::new().spawn_scoped(scope, answer).is_err() {
                    open.remove(connection);
                }
            }
        });
        while let Some(now) = tick() {
            *locked(stamp) = now;
            thread::sleep(TICK);
        }
        stop.store(true, Ordering::Relaxed);
        open.end();
        // This connection wakes the thread that accepts connections, which then sees `stop`.
        let _ = TcpStream::connect_timeout(&server.address, TICK);
    });
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Open connections, oldest first.
#[derive(Default)]
struct Connections(Mutex<Open>);

#[derive(Default)]
struct Open {
    streams: Vec<Connection>,
    last: u64,
    ended: bool,
}

struct Connection {
    number: u64,
    stream: TcpStream,
    /// True if the connection's request has been received completely.
    complete: bool,
}

impl Connections {
    /// Adds a connection and returns its number. If there are too many connections, the function
    /// closes the oldest connection without a complete request, or the oldest connection if all
    /// requests are complete. Returns `None` after [`Connections::end`], or if the stream cannot be
    /// cloned.
    fn add(&self, stream: &TcpStream) -> Option<u64> {
        let stream = stream.try_clone().ok()?;
        let mut open = locked(&self.0);
        if open.ended {
            return None;
        }
        if open.streams.len() >= MOST {
            let waits = open.streams.iter().position(|connection| !connection.complete);
            // The shutdown wakes the thread of this connection, which then ends.
            let _ = open.streams.remove(waits.unwrap_or(0)).stream.shutdown(Shutdown::Both);
        }
        open.last += 1;
        let number = open.last;
        open.streams.push(Connection { number, stream, complete: false });
        Some(number)
    }

    fn has_request(&self, number: u64) {
        let mut open = locked(&self.0);
        open.streams
            .iter_mut()
            .filter(|connection| connection.number == number)
            .for_each(|found| found.complete = true);
    }

    fn remove(&self, number: u64) {
        locked(&self.0).streams.retain(|connection| connection.number != number);
    }

    /// Closes all connections, and refuses later ones.
    fn end(&self) {
        let mut open = locked(&self.0);
        open.ended = true;
        for connection in open.streams.drain(..) {
            let _ = connection.stream.shutdown(Shutdown::Both);
        }
    }
}

/// A request without a body.
struct Request {
    method: String,
    target: String,
    host: Option<String>,
}

/// Status, kind and content of a response.
struct Reply {
    status: u16,
    kind: &'static str,
    content: Content,
}

enum Content {
    Bytes(Vec<u8>),
    /// A file and its length.
    File(File, u64),
}

impl Reply {
    fn text(status: u16, text: &str) -> Self {
        Self { status, kind: "text/plain; charset=utf-8", content: Content::Bytes(text.as_bytes().to_vec()) }
    }
}

/// Answers one request. Calls `complete` when the request has been read. An error only closes the
/// connection, since errors of a connection cannot be reported.
fn answer(mut stream: &TcpStream, site: Site<'_>, stamp: &Mutex<String>, complete: impl FnOnce()) {
    let request = match read_request(stream) {
        Ok(request) => request,
        Err(None) => return,
        Err(Some(refusal)) => {
            let _ = write(stream, refusal, true);
            return linger(stream);
        }
    };
    complete();
    let stamp = locked(stamp).clone();
    let reply = reply(&request.method, request.host.as_deref(), &request.target, site, &stamp);
    if write(stream, reply, request.method != "HEAD").is_ok() {
        let _ = stream.flush();
    }
    linger(stream);
}

/// Reads the head of a request. An error contains the response that refuses the request, or `None`
/// if the client has gone.
fn read_request(mut stream: &TcpStream) -> Result<Request, Option<Reply>> {
    let deadline = Instant::now() + HEAD_TIME;
    let (mut head, mut part) = (Vec::new(), [0; 2048]);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        let late = || Some(Reply::text(408, "expected the head of the request within 5 s\n"));
        if left.is_zero() {
            return Err(late());
        }
        if stream.set_read_timeout(Some(left)).is_err() {
            return Err(None);
        }
        let count = match stream.read(&mut part) {
            Ok(0) => return Err(None),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                return Err(late());
            }
            Err(_) => return Err(None),
        };
        // Two reads may split the mark that ends the head, so the search begins 3 bytes earlier.
        let before = head.len().saturating_sub(3);
        head.extend_from_slice(&part[..count]);
        let ends = |end: &[u8]| head[before..].windows(end.len()).any(|window| window == end);
        if ends(b"\n\r\n") || ends(b"\n\n") {
            return parse(&head).map_err(Some);
        }
        if head.len() > HEAD {
            return Err(Some(Reply::text(
                431,
                "expected a request whose head has at most 16 KiB, found a longer head\n",
            )));
        }
    }
}

/// Parses a complete head.
fn parse(head: &[u8]) -> Result<Request, Reply> {
    let mut fields = [httparse::EMPTY_HEADER; FIELDS];
    let mut request = httparse::Request::new(&mut fields);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Err(httparse::Error::TooManyHeaders) => {
            return Err(Reply::text(431, "expected a request with at most 64 header fields, found more fields\n"));
        }
        _ => return Err(Reply::text(400, "expected a request of HTTP, found other bytes\n")),
    }
    let method = request.method.unwrap_or_default().to_owned();
    if !matches!(method.as_str(), "GET" | "HEAD") {
        return Err(Reply::text(405, "expected GET or HEAD, found another method\n"));
    }
    let field = |name: &str| request.headers.iter().find(|field| field.name.eq_ignore_ascii_case(name));
    let empty = field("Content-Length").is_none_or(|length| length.value.trim_ascii() == b"0");
    if !empty || field("Transfer-Encoding").is_some() {
        return Err(Reply::text(413, "expected a request without a body, found a request with a body\n"));
    }
    let host = field("Host").map(|host| String::from_utf8_lossy(host.value).into_owned());
    Ok(Request { method, target: request.path.unwrap_or_default().to_owned(), host })
}

fn write(mut stream: &TcpStream, reply: Reply, with_content: bool) -> io::Result<()> {
    stream.set_write_timeout(Some(WRITE_TIME))?;
    let length = match &reply.content {
        Content::Bytes(bytes) => bytes.len() as u64,
        Content::File(_, length) => *length,
    };
    let (status, kind, reason) = (reply.status, reply.kind, reason(reply.status));
    let allow = if status == 405 { "Allow: GET, HEAD\r\n" } else { "" };
    let head = format!(
        "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\n{allow}Connection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    if !with_content {
        return Ok(());
    }
    match reply.content {
        Content::Bytes(bytes) => stream.write_all(&bytes),
        Content::File(file, length) => {
            // Send exactly the announced length, even if the file grows in the meantime.
            let (mut file, mut part) = (file.take(length), vec![0; PART]);
            loop {
                match file.read(&mut part)? {
                    0 => return Ok(()),
                    count => stream.write_all(&part[..count])?,
                }
            }
        }
    }
}

/// Closes a connection so that the client receives the response, even if the client is still
/// sending.
fn linger(mut stream: &TcpStream) {
    if stream.shutdown(Shutdown::Write).is_err() {
        return;
    }
    let deadline = Instant::now() + LINGER;
    let mut part = [0; 4096];
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() || stream.set_read_timeout(Some(left)).is_err() {
            return;
        }
        match stream.read(&mut part) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
    }
}

fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        204 => "No Content",
        400 => "Bad Request",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        413 => "Content Too Large",
        431 => "Request Header Fields Too Large",
        _ => "",
    }
}

/// Makes the response to a request.
fn reply(method: &str, host: Option<&str>, url: &str, site: Site<'_>, stamp: &str) -> Reply {
    if !matches!(method, "GET" | "HEAD") {
        return Reply::text(405, "expected GET or HEAD, found another method\n");
    }
    // This check prevents DNS rebinding: a foreign page whose name resolves to this machine sends
    // its own name as the host, and is refused.
    let name = host.unwrap_or_default();
    let name =
        name.rsplit_once(':').filter(|(_, port)| port.bytes().all(|b| b.is_ascii_digit())).map_or(name, |(n, _)| n);
    if !["localhost", "127.0.0.1"].contains(&name) {
        return Reply::text(403, "expected the host localhost or 127.0.0.1, found another host\n");
    }
    let (path, query) = url.split_once('?').unwrap_or((url, ""));
    let path = path.split('#').next().unwrap_or_default();
    if path == STAMP {
        return Reply::text(200, stamp);
    }
    let bytes = |kind, bytes| Reply { status: 200, kind, content: Content::Bytes(bytes) };
    if let Some(feed) = site.live {
        match path {
            SCRIPT => return bytes("text/javascript; charset=utf-8", feed.script().into()),
            STATES => {
                return feed
                    .frame(query)
                    .map_or_else(|| Reply::text(204, ""), |frame| bytes("application/octet-stream", frame));
            }
            LOOK if feed.look(query) => return Reply::text(204, ""),
            LOOK => return Reply::text(403, "expected the page's secret and a slope, found another query\n"),
            _ => {}
        }
    }
    let missing = || Reply::text(404, "expected the path of a file of this page, found another path\n");
    let Some(file) = file_of(site.root, path) else { return missing() };
    if file.file_name().is_some_and(|name| name == "index.html") {
        let Ok(bytes) = std::fs::read(&file) else { return missing() };
        let page = String::from_utf8_lossy(&bytes);
        let page = match site.live {
            Some(feed) => {
                let page = page.replacen(PRELOAD, "", 1).replacen(ELEMENT[0], ELEMENT[1], 1);
                page.replacen("</body>", &follow(feed.word()), 1)
            }
            None => page.replacen("</body>", &RELOAD.replace("STAMP", stamp), 1),
        };
        let content = Content::Bytes(page.into_bytes());
        return Reply { status: 200, kind: "text/html; charset=utf-8", content };
    }
    let kind = kind_of(&file);
    let opened = File::open(&file).and_then(|file| file.metadata().map(|data| (file, data.len())));
    opened
        .map_or_else(|_| missing(), |(file, length)| Reply { status: 200, kind, content: Content::File(file, length) })
}

/// Finds the file of a request's path. `None` for paths that leave the folder, even through links,
/// for paths with a name that begins with a dot, and for anything but a regular file.
fn file_of(root: &Path, path: &str) -> Option<PathBuf> {
    let decoded = percent_decode_str(path.strip_prefix('/')?).decode_utf8().ok()?;
    let relative =
        if decoded.is_empty() || decoded.ends_with('/') { format!("{decoded}index.html") } else { decoded.into() };
    let plain = !relative.contains(['\\', '\0', ':'])
        && Path::new(&relative).components().all(|part| match part {
            Component::Normal(name) => !name.to_string_lossy().starts_with('.'),
            _ => false,
        });
    let file = plain.then(|| root.join(&relative))?.canonicalize().ok()?;
    (file.starts_with(root.canonicalize().ok()?) && file.is_file()).then_some(file)
}

fn kind_of(file: &Path) -> &'static str {
    match file.extension().and_then(|extension| extension.to_str()).unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" => "application/json",
        "wasm" => "application/wasm",
        "png" => "image/png",
        "jpg" | "jpeg" => "image/jpeg",
        "svg" => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let site = folder.path().join("site");
        std::fs::create_dir_all(site.join("app")).unwrap();
        std::fs::write(folder.path().join("secret.txt"), "secret").unwrap();
        for (name, text) in [("index.html", "<body>page</body>"), ("app/a b.wasm", "module"), (".hidden", "x")] {
            std::fs::write(site.join(name), text).unwrap();
        }
        folder
    }

    fn get(root: &Path, url: &str) -> (u16, &'static str, String) {
        let Reply { status, kind, content } = reply("GET", Some("localhost:80"), url, Site { root, live: None }, "7");
        let text = match content {
            Content::Bytes(bytes) => String::from_utf8(bytes).unwrap(),
            Content::File(mut file, length) => {
                let mut text = String::new();
                file.read_to_string(&mut text).unwrap();
                assert_eq!(text.len() as u64, length);
                text
            }
        };
        (status, kind, text)
    }

    #[test]
    fn files_have_their_kinds() {
        let folder = folder();
        let root = folder.path().join("site");
        assert_eq!(get(&root, "/app/a%20b.wasm?x=1"), (200, "application/wasm", "module".into()));
        let (status, kind, page) = get(&root, "/");
        assert!(status == 200 && kind.starts_with("text/html") && page.contains("location.reload()"), "{page}");
        // The page contains the stamp of its own content, so that even its first check detects a
        // change.
        assert!(page.contains("const was='7'"), "{page}");
        assert_eq!(get(&root, "/.stamp").2, "7");
    }

    #[test]
    fn nothing_outside_the_folder_is_handed_out() {
        let folder = folder();
        let root = folder.path().join("site");
        for url in [
            "/../secret.txt",
            "/%2e%2e/secret.txt",
            "/app/../../secret.txt",
            "/..%2fsecret.txt",
            "/..%5csecret.txt",
            "//etc/passwd",
            "/%2fetc/passwd",
            "/app",
            "/nothing",
            "/.hidden",
            "/%00",
            "/%ff",
            "",
            "secret.txt",
            "/C:/secret.txt",
        ] {
            assert_eq!(get(&root, url).0, 404, "{url}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.path().join("secret.txt"), root.join("link.txt")).unwrap();
            assert_eq!(get(&root, "/link.txt").0, 404);
            std::os::unix::fs::symlink(folder.path(), root.join("up")).unwrap();
            assert_eq!(get(&root, "/up/secret.txt").0, 404);
            assert_eq!(get(&root, "/up/site/index.html").0, 200, "the path leads back into the folder");
        }
    }

    #[test]
    fn other_names_and_methods_are_refused() {
        let folder = folder();
        let root = folder.path().join("site");
        let status =
            |method: &str, host: Option<&str>| reply(method, host, "/", Site { root: &root, live: None }, "").status;
        assert_eq!(status("HEAD", Some("127.0.0.1:8000")), 200);
        assert_eq!(status("POST", Some("localhost")), 405);
        for host in [None, Some("example.org"), Some("localhost.example.org"), Some("127.0.0.1.example.org:80")] {
            assert_eq!(status("GET", host), 403, "{host:?}");
        }
    }

    /// Requests the page. Returns the stream, and the response up to the end of its body.
    fn ask(mut stream: TcpStream, method: &str, port: u16) -> (TcpStream, String) {
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        write!(stream, "{method} / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n").unwrap();
        let (mut text, mut part) = (String::new(), [0; 4096]);
        let complete = |text: &str| {
            let (header, body) = text.split_once("\r\n\r\n")?;
            let length = header.lines().find_map(|line| line.strip_prefix("Content-Length: "))?;
            Some(method == "HEAD" || body.len() >= length.parse().unwrap())
        };
        while complete(&text) != Some(true) {
            let count = stream.read(&mut part).expect("an answer in time");
            assert!(count > 0, "cut short: {text}");
            text += std::str::from_utf8(&part[..count]).unwrap();
        }
        (stream, text)
    }

    /// A browser opens six connections in parallel, and keeps every connection that the server
    /// keeps. The page must also arrive over many open connections. This test uses real sockets on
    /// this machine alone.
    #[test]
    fn browsers_with_many_connections_get_the_page() {
        const CONNECTIONS: usize = 24;
        let folder = folder();
        let server = listen(0).unwrap();
        let (port, root) = (port_of(&server), folder.path().join("site"));
        assert!(server.address.ip().is_loopback());
        let clients = std::thread::spawn(move || {
            let streams: Vec<_> = (0..CONNECTIONS).map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap()).collect();
            let mut kept = Vec::new();
            for stream in streams {
                let (stream, text) = ask(stream, "GET", port);
                assert!(text.starts_with("HTTP/1.1 200 OK") && text.contains("text/html"), "{text}");
                assert!(text.contains("page") && text.ends_with("</body>"), "{text}");
                if !text.contains("Connection: close") {
                    kept.push(stream);
                }
            }
            let (_, text) = ask(TcpStream::connect(("127.0.0.1", port)).unwrap(), "HEAD", port);
            assert!(text.starts_with("HTTP/1.1 200 OK") && text.ends_with("\r\n\r\n"), "{text}");
        });
        serve(&server, Site { root: &root, live: None }, || (!clients.is_finished()).then(String::new));
        clients.join().unwrap();
    }

    /// Serves a folder while `clients`, which receives the server's port, makes requests.
    fn against(clients: impl FnOnce(u16) + Send + 'static) {
        let folder = folder();
        let root = folder.path().join("site");
        // The file exceeds the system's buffer for a connection, so the server must wait until the
        // client has read some of the response.
        std::fs::write(root.join("large.bin"), vec![7; 32 << 20]).unwrap();
        let server = listen(0).unwrap();
        let port = port_of(&server);
        let clients = thread::spawn(move || clients(port));
        serve(&server, Site { root: &root, live: None }, || (!clients.is_finished()).then(String::new));
        clients.join().unwrap();
    }

    fn connect(port: u16) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    /// Asserts that an ordinary request gets its response long before blocked requests time out.
    fn page_comes_at_once(port: u16, case: &str) {
        let start = Instant::now();
        let (_, text) = ask(connect(port), "GET", port);
        let took = start.elapsed();
        assert!(text.starts_with("HTTP/1.1 200 OK") && text.ends_with("</body>"), "{case}: {text}");
        assert!(took < Duration::from_secs(3), "{case}: {took:?}");
    }

    /// Sends bytes to the server, and returns the whole response.
    fn response_to(port: u16, bytes: &[u8]) -> String {
        let mut stream = connect(port);
        // The server may refuse the request before all bytes are written, so ignore errors of the
        // write.
        let _ = stream.write_all(bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    #[test]
    fn two_hundred_blocked_connections_delay_no_other() {
        against(|port| {
            for (start, case) in [
                ("", "connections that say nothing"),
                ("GET / HT", "requests without an end"),
                ("GET /large.bin HTTP/1.1\r\nHost: localhost\r\n\r\n", "clients that do not read"),
            ] {
                let stuck: Vec<TcpStream> = (0..200)
                    .map(|_| {
                        let mut stream = connect(port);
                        // The server may have closed the connection already, so ignore errors of
                        // the write.
                        let _ = stream.write_all(start.as_bytes());
                        stream
                    })
                    .collect();
                (0..3).for_each(|_| page_comes_at_once(port, case));
                drop(stuck);
                page_comes_at_once(port, case);
            }
        });
    }

    #[test]
    fn a_head_that_comes_byte_by_byte_ends_in_time() {
        against(|port| {
            let mut slow = connect(port);
            let start = Instant::now();
            let head = "GET / HTTP/1.1\r\nHost: localhost\r\nX-A: ".bytes().chain(std::iter::repeat(b'a'));
            for byte in head {
                if slow.write_all(&[byte]).is_err() || start.elapsed() > HEAD_TIME + Duration::from_secs(3) {
                    break;
                }
                page_comes_at_once(port, "a slow head");
                thread::sleep(Duration::from_millis(300));
            }
            let took = start.elapsed();
            assert!(took < HEAD_TIME + Duration::from_secs(2), "{took:?}");
            let mut answer = Vec::new();
            let _ = slow.read_to_end(&mut answer);
            let answer = String::from_utf8_lossy(&answer).into_owned();
            assert!(answer.is_empty() || answer.starts_with("HTTP/1.1 408 "), "{answer}");
        });
    }

    #[test]
    fn bodies_and_long_heads_are_refused_unread() {
        against(|port| {
            let host = format!("Host: localhost:{port}\r\n");
            let long = format!("GET / HTTP/1.1\r\n{host}X-Long: {}\r\n\r\n", "a".repeat(1 << 20));
            let many = format!("GET / HTTP/1.1\r\n{host}{}\r\n", "X-A: b\r\n".repeat(100));
            for (request, status) in [
                (format!("GET / HTTP/1.1\r\n{host}Content-Length: 10000000000\r\n\r\nabc"), 413),
                (format!("GET / HTTP/1.1\r\n{host}content-length: 3\r\n\r\nabc"), 413),
                (format!("GET / HTTP/1.1\r\n{host}Content-Length: -1\r\n\r\n"), 413),
                (format!("GET / HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\n\r\nffffffff\r\nabc"), 413),
                (format!("POST / HTTP/1.1\r\n{host}Content-Length: 10000000000\r\n\r\nabc"), 405),
                (format!("PUT / HTTP/1.1\r\n{host}Transfer-Encoding: chunked\r\n\r\n3\r\nabc\r\n0\r\n\r\n"), 405),
                (format!("DELETE / HTTP/1.1\r\n{host}\r\n"), 405),
                (long, 431),
                (many, 431),
                ("\x16\x03\x01\x02 a handshake of TLS\n\n".into(), 400),
                (format!("GET / HTTP/1.1\r\n{host}Content-Length: 0\r\n\r\n"), 200),
                (format!("GET /%2e%2e/secret.txt HTTP/1.1\r\n{host}\r\n"), 404),
                (format!("GET /../secret.txt HTTP/1.1\r\n{host}\r\n"), 404),
                (format!("GET http://localhost/ HTTP/1.1\r\n{host}\r\n"), 404),
            ] {
                let start = Instant::now();
                let answer = response_to(port, request.as_bytes());
                let shown = &request[..request.len().min(80)];
                assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{shown:?}: {answer}");
                assert!(start.elapsed() < Duration::from_secs(3), "{shown:?}: {:?}", start.elapsed());
                page_comes_at_once(port, shown);
            }
        });
    }

    #[test]
    fn a_large_file_arrives_whole() {
        against(|port| {
            let request = format!("GET /large.bin HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n");
            let mut stream = connect(port);
            stream.write_all(request.as_bytes()).unwrap();
            let mut answer = Vec::new();
            stream.read_to_end(&mut answer).unwrap();
            let body = answer.windows(4).position(|window| window == b"\r\n\r\n").unwrap() + 4;
            assert_eq!(answer.len() - body, 32 << 20);
            assert!(answer[body..].iter().all(|byte| *byte == 7));
        });
    }
}
