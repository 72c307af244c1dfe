//! The protocol's description: every message in it is one, and both encodings carry it.

use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, ServerMessage};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeSet;
use std::fmt::Debug;

/// Texts of the fenced blocks whose first line says `of`.
fn blocks(of: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut parts = include_str!("../README.md").split("```");
    while let (Some(_), Some(block)) = (parts.next(), parts.next()) {
        let (language, text) = block.split_once('\n').expect("a block has lines");
        if language == of {
            found.push(text.to_owned());
        }
    }
    found
}

/// The types of the messages in the blocks. Bytes of both encodings are printed.
fn types<M: DeserializeOwned + Serialize + PartialEq + Debug>(of: &str) -> BTreeSet<String> {
    let mut types = BTreeSet::new();
    let (mut json, mut packed) = (0, 0);
    for block in blocks(of) {
        let frame: Vec<M> = Encoding::Json.read(block.as_bytes()).unwrap_or_else(|error| panic!("{block}\n{error}"));
        for encoding in [Encoding::Json, Encoding::MessagePack] {
            let written = encoding.write(&frame);
            assert_eq!(encoding.read::<M>(&written).expect("what was written"), frame);
            *(if encoding == Encoding::Json { &mut json } else { &mut packed }) += written.len();
        }
        let values: Vec<serde_json::Value> = serde_json::from_str(&block).expect("a list");
        types.extend(values.iter().filter_map(|value| value["type"].as_str().map(str::to_owned)));
    }
    println!("{of}: {json} bytes of JSON, {packed} of MessagePack");
    types
}

#[test]
fn every_message_is_described() {
    let client = types::<ClientMessage>("json client");
    let expected = [
        "arrived",
        "bye",
        "completed",
        "dropped",
        "failed",
        "hello",
        "path",
        "progress",
        "responded",
        "settings",
        "view",
    ];
    assert!(client.iter().eq(expected.iter()), "{client:?}");
    let server = types::<ServerMessage>("json server");
    let expected = ["cancel", "discard", "error", "estimates", "fetch", "switch", "wait", "welcome"];
    assert!(server.iter().eq(expected.iter()), "{server:?}");
}

#[cfg(feature = "schema")]
#[test]
fn the_schema_names_every_message() {
    use foresight_wire::schema;
    for (schema, words) in [
        (schema::client_frame(), ["hello", "view", "settings", "bye", "memory_bytes"].as_slice()),
        (schema::server_frame(), ["welcome", "fetch", "discard_on_arrival", "estimates", "switch"].as_slice()),
    ] {
        let text = serde_json::to_string(&schema).expect("a schema is JSON");
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
        assert!(text.contains("\"array\""), "{text}");
    }
}

#[test]
fn frames_are_bounded_before_they_are_read() {
    let long = vec![b' '; foresight_wire::encoding::FRAME_BYTES_MAX + 1];
    for encoding in [Encoding::Json, Encoding::MessagePack] {
        let error = encoding.read::<ClientMessage>(&long).expect_err("too long").to_string();
        assert_eq!(error, "the frame has 1048577 bytes; expected at most 1048576");
    }
    let deep = [b'['; 17];
    let error = Encoding::Json.read::<ClientMessage>(&deep).expect_err("too deep").to_string();
    assert!(error.contains("byte 16 of the frame lies more than 16"), "{error}");
    // Brackets in a text are none.
    let text = format!(r#"[{{"type":"failed","t_ns":0,"rep":1,"reason":"\"{}"}}]"#, "[".repeat(50));
    assert_eq!(Encoding::Json.read::<ClientMessage>(text.as_bytes()).expect("a frame").len(), 1);
    // The last bit of a number survives.
    for number in [0.1 + 0.2, 1.0 / 3.0, 5e-324, -f64::MIN_POSITIVE, f64::MAX, 123_456_789.123_456_79] {
        let text = format!(
            r#"[{{"type":"view","t_ns":0,"cameras":[{{"position":[{number:e},0,0],"orientation":[0,0,0,1],"fov_y":1,"viewport":[1,1]}}]}}]"#
        );
        let frame: Vec<ClientMessage> = Encoding::Json.read(text.as_bytes()).expect("a frame");
        let ClientMessage::View(views) = &frame[0] else { panic!("{frame:?}") };
        assert_eq!(views.cameras[0].position[0].to_bits(), f64::to_bits(number), "{number:e}");
    }
}
