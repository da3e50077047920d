//! The page over HTTP, asked properly and not.

use std::io::{Read, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use eecvs_hub::board::Board;
use event_emulator::Preset;

use super::EXACT;
use crate::feed::{Served, Way, name, scene, stamp};

fn fed() -> Arc<Board> {
    let board = Arc::new(Board::new("hall"));
    let scene = scene(Preset::IndoorFlying, Way::of(EXACT));
    let cam = name("hall-2/door");
    board.frame(&cam, stamp(1, 0, 0), &scene.frames[0]);
    board.want(&cam);
    board.frame(&cam, stamp(1, 1, 0), &scene.frames[1]);
    board
}

#[test]
fn the_page_and_its_data_are_served() {
    let mut served = Served::new(&fed());
    let page = served.get("/");
    assert_eq!(page.status, 200);
    let nonce = page
        .head
        .split("'nonce-")
        .nth(1)
        .unwrap()
        .split('\'')
        .next()
        .unwrap();
    assert!(nonce.len() == 32 && page.text().contains(&format!("<script nonce=\"{nonce}\">")));
    assert!(!page.text().contains("{nonce}"));
    assert!(
        served
            .get("/")
            .head
            .split("'nonce-")
            .nth(1)
            .unwrap()
            .split('\'')
            .next()
            != Some(nonce)
    );
    let data = served.get("/sensors.json?see=hall-2/door&see=nobody&see=&x");
    let json: serde_json::Value = serde_json::from_slice(&data.body).unwrap();
    assert_eq!(json["hub"], "hall");
    assert_eq!(json["sensors"][0]["name"], "hall-2/door");
    assert_eq!(json["sensors"][0]["window"]["times"], "exact");
    assert_eq!(json["sensors"][0]["picture"], 1);
    assert!(served.get("/metrics").text().ends_with("# EOF\n"));
    let picture = served.get("/picture/hall-2/door.png?1");
    assert_eq!((picture.status, &picture.body[1..4]), (200, &b"PNG"[..]));
    for answer in [&page, &data, &picture] {
        for part in [
            "x-content-type-options: nosniff",
            "cache-control: no-store",
            "default-src 'none'",
        ] {
            assert!(answer.head.contains(part), "{}", answer.head);
        }
        assert!(!answer.head.contains("access-control"));
    }
    for path in [
        "/x",
        "/index.html",
        "/picture/nobody.png",
        "/picture/hall-2/door",
        "/picture/",
        "/picture/a//b.png",
        "/picture/..%2f..%2fetc/passwd.png",
        "/sensors.json/",
        "//",
    ] {
        assert_eq!(served.get(path).status, 404, "{path}");
    }
    let address = served.address;
    let with = |method: &str, host: &str| {
        let host = if host.is_empty() {
            String::new()
        } else {
            format!("Host: {host}\r\n")
        };
        served.ask(&format!(
            "{method} / HTTP/1.1\r\n{host}Connection: close\r\n\r\n"
        ))
    };
    let head = with("HEAD", &address.to_string());
    assert_eq!((head.status, head.body.len()), (200, 0));
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "PATCH"] {
        assert_eq!(with(method, &address.to_string()).status, 405, "{method}");
    }
    for host in [
        "localhost",
        "LOCALHOST:80",
        "127.0.0.1",
        "[::1]:8080",
        "[::1]",
        "10.1.2.3:1",
    ] {
        assert_eq!(with("GET", host).status, 200, "{host}");
    }
    for host in [
        "",
        "example.org",
        "127.0.0.1.example.org:80",
        "localhost.example.org",
        "[::1",
        "a:b:c",
        ":80",
    ] {
        assert_eq!(with("GET", host).status, 421, "{host}");
    }
    let absolute =
        format!("GET http://example.org/ HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    assert_eq!(served.ask(&absolute).status, 421);
    let started = Instant::now();
    served.stop();
    assert!(started.elapsed() < Duration::from_secs(2));
    assert!(std::net::TcpStream::connect(address).is_err());
}

#[test]
fn garbage_over_http_does_no_harm() {
    let board = fed();
    let mut served = Served::new(&board);
    let before = board.rows()[0].frames_received;
    let quick = |what: &str| {
        let started = Instant::now();
        assert_eq!(served.get("/sensors.json").status, 200, "{what}");
        assert!(
            started.elapsed() < Duration::from_secs(2),
            "{what}: {:?}",
            started.elapsed()
        );
    };
    let mut word = 1_u64;
    let mut random = |count: usize| -> Vec<u8> {
        let mut next = || {
            word ^= word << 13;
            word ^= word >> 7;
            word ^= word << 17;
            word as u8
        };
        (0..count).map(|_| next()).collect()
    };
    for count in [1, 2, 10, 100, 10_000, 1_000_000] {
        let mut stream = served.connect();
        let bytes = random(count);
        // It may have been closed before all is written.
        let _ = stream.write_all(&bytes);
        quick("random bytes");
    }
    let mut half = served.connect();
    half.write_all(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-")
        .unwrap();
    quick("half a request");
    let mut long = served.connect();
    let line = [&b"GET / HTTP/1.1\r\nX: "[..], &vec![b'a'; 8 << 20]].concat();
    let _ = long.write_all(&line);
    let mut answer = Vec::new();
    let _ = long.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    assert!(
        answer.is_empty() || answer.starts_with("HTTP/1.1 431"),
        "{answer}"
    );
    quick("a long header");
    // Many that ask and do not read, and many that say nothing.
    let deaf: Vec<_> = (0..50)
        .map(|_| {
            let mut stream = served.connect();
            let request = b"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".repeat(50);
            let _ = stream.write_all(&request);
            stream
        })
        .collect();
    quick("clients that do not read");
    let started = Instant::now();
    let idle: Vec<_> = (0..300).map(|_| served.connect()).collect();
    quick("300 idle connections");
    // Too many: the oldest that never asked are closed at once, the others after a while.
    let is_closed = |stream: &std::net::TcpStream| {
        let mut stream = stream;
        matches!(stream.read(&mut [0]), Ok(0) | Err(_))
    };
    assert!(is_closed(&idle[0]) && started.elapsed() < Duration::from_secs(5));
    assert!(is_closed(&idle[299]), "idle without end");
    let took = started.elapsed();
    assert!(
        took > Duration::from_secs(5) && took < Duration::from_secs(15),
        "{took:?}"
    );
    assert!(is_closed(&half));
    quick("after all of it");
    drop(deaf);
    assert_eq!(board.rows().len(), 1);
    assert_eq!(board.rows()[0].frames_received, before);
    served.stop();
}
