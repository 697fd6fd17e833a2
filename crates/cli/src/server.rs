//! Hands out a folder's files on the loopback interface: nothing outside the folder, nothing to other machines.

use std::io::Write as _;
use std::net::Ipv4Addr;
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use percent_encoding::percent_decode_str;
use tiny_http::{Method, Request, Server, StatusCode};

/// Where the page asks whether the stack has changed.
const STAMP: &str = "/.stamp";
/// How long one wait for a request lasts.
const TICK: Duration = Duration::from_millis(200);

/// Asks once a second and reloads when the folder has changed since the page was handed out; the page keeps its state in its address.
const RELOAD: &str = "<script>{const was='STAMP';setInterval(async()=>{try{\
    const answer=await fetch('.stamp',{cache:'no-store'});if(answer.ok&&await answer.text()!==was)location.reload()\
    }catch{}},1000)}</script></body>";

/// Starts listening; `port` 0 takes any that is free.
pub(crate) fn listen(port: u16) -> Result<Server, String> {
    Server::http((Ipv4Addr::LOCALHOST, port)).map_err(|error| error.to_string())
}

/// The port that a server listens on.
pub(crate) fn port_of(server: &Server) -> u16 {
    server.server_addr().to_ip().map_or(0, |address| address.port())
}

/// Answers requests until `tick` says to stop; it is asked at least five times a second and gives what changes whenever the folder does.
pub(crate) fn serve(server: &Server, root: &Path, mut tick: impl FnMut() -> Option<String>) {
    while let Some(stamp) = tick() {
        if let Ok(Some(request)) = server.recv_timeout(TICK) {
            answer(request, root, &stamp);
        }
    }
}

/// Every answer ends its connection. The library serves each by a thread of a small pool, in which others may wait until a browser lets go of one that it
/// keeps for later; and it offers no way to say so, hence the header by hand.
fn answer(request: Request, root: &Path, stamp: &str) {
    let (status, kind, bytes) = reply(request.method(), host_of(&request).as_deref(), request.url(), root, stamp);
    let body = if *request.method() == Method::Head { &[][..] } else { &bytes };
    let header = format!(
        "HTTP/1.1 {status} {}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n",
        StatusCode(status).default_reason_phrase(),
        bytes.len()
    );
    let mut writer = request.into_writer();
    // a browser that went away wants no answer
    let _ = writer.write_all(header.as_bytes()).and_then(|()| writer.write_all(body)).and_then(|()| writer.flush());
}

fn host_of(request: &Request) -> Option<String> {
    request.headers().iter().find(|header| header.field.equiv("Host")).map(|header| header.value.to_string())
}

/// Status, kind and content for a request.
fn reply(method: &Method, host: Option<&str>, url: &str, root: &Path, stamp: &str) -> (u16, &'static str, Vec<u8>) {
    let text = |status: u16, text: &str| (status, "text/plain; charset=utf-8", text.as_bytes().to_vec());
    if !matches!(method, Method::Get | Method::Head) {
        return text(405, "only GET and HEAD\n");
    }
    // a page elsewhere whose name was made to lead here asks under its own name
    let name = host.unwrap_or_default();
    let name =
        name.rsplit_once(':').filter(|(_, port)| port.bytes().all(|b| b.is_ascii_digit())).map_or(name, |(n, _)| n);
    if !["localhost", "127.0.0.1"].contains(&name) {
        return text(403, "only for this machine: open http://localhost\n");
    }
    let path = url.split(['?', '#']).next().unwrap_or_default();
    if path == STAMP {
        return text(200, stamp);
    }
    let Some(file) = file_of(root, path) else { return text(404, "there is no such file in the preview\n") };
    match std::fs::read(&file) {
        Ok(bytes) if file.file_name().is_some_and(|name| name == "index.html") => {
            let page = String::from_utf8_lossy(&bytes).replacen("</body>", &RELOAD.replace("STAMP", stamp), 1);
            (200, "text/html; charset=utf-8", page.into_bytes())
        }
        Ok(bytes) => (200, kind_of(&file), bytes),
        Err(_) => text(404, "there is no such file in the preview\n"),
    }
}

/// The file that a path means; `None` for what is not a plain file inside the folder, also by way of links.
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
        "svg" => "image/svg+xml",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read as _;
    use std::net::TcpStream;

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
        let (status, kind, bytes) = reply(&Method::Get, Some("localhost:80"), url, root, "7");
        (status, kind, String::from_utf8(bytes).unwrap())
    }

    #[test]
    fn files_have_their_kinds() {
        let folder = folder();
        let root = folder.path().join("site");
        assert_eq!(get(&root, "/app/a%20b.wasm?x=1"), (200, "application/wasm", "module".into()));
        let (status, kind, page) = get(&root, "/");
        assert!(status == 200 && kind.starts_with("text/html") && page.contains("location.reload()"), "{page}");
        // a change between the page and its first question is not missed
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
        }
    }

    #[test]
    fn other_names_and_methods_are_refused() {
        let folder = folder();
        let root = folder.path().join("site");
        let status = |method: &Method, host: Option<&str>| reply(method, host, "/", &root, "").0;
        assert_eq!(status(&Method::Head, Some("127.0.0.1:8000")), 200);
        assert_eq!(status(&Method::Post, Some("localhost")), 405);
        for host in [None, Some("example.org"), Some("localhost.example.org"), Some("127.0.0.1.example.org:80")] {
            assert_eq!(status(&Method::Get, host), 403, "{host:?}");
        }
    }

    /// Asks for a page; gives the stream and what came until all of the body had.
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

    /// Through sockets, from a server that listens to this machine alone. A browser opens six at once and keeps those that it may keep.
    #[test]
    fn browsers_with_many_connections_get_the_page() {
        const CONNECTIONS: usize = 24;
        let folder = folder();
        let server = listen(0).unwrap();
        let (port, root) = (port_of(&server), folder.path().join("site"));
        assert!(server.server_addr().to_ip().unwrap().ip().is_loopback());
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
        serve(&server, &root, || (!clients.is_finished()).then(String::new));
        clients.join().unwrap();
    }
}
