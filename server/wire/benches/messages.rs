//! What a frame costs: reading it, answering it, and writing the answers.

use criterion::{Criterion, criterion_group, criterion_main};
use foresight_index::generate::city::{CityParams, city};
use foresight_scheduler::lod_tree::RepId;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{
    Camera, ClientMessage, Event, Hello, Mode, Progress, Refinement, ServerMessage, VERSION, Views,
};
use foresight_wire::session::{Session, SessionLimits, SessionWorld};
use std::hint::black_box;

const TICK_NS: u64 = 16_666_667;

/// A view, the bytes so far, and two representations that came.
fn typical(t_ns: u64, x: f64) -> Vec<ClientMessage> {
    let (position, orientation) = ([x - 200.0, 5.103_2, 20.071_3], [0.5, -0.5, -0.5, 0.5]);
    let camera = Camera { position, orientation, fov_y: 1.047_197_551_196_597_6, viewport: [1920, 1080], weight: 1.0 };
    vec![
        ClientMessage::Responded(Event { t_ns, rep: 12_345 }),
        ClientMessage::Arrived(Event { t_ns, rep: 12_345 }),
        ClientMessage::Completed(Event { t_ns, rep: 12_344 }),
        ClientMessage::Progress(Progress { t_ns, total_bytes: 123_456_789, in_flight_bytes: 65_536 }),
        ClientMessage::View(Views { t_ns, cameras: vec![camera] }),
    ]
}

fn encodings(c: &mut Criterion) {
    let frame = typical(61_083_333_611, 41.250_1);
    for (name, encoding) in [("json", Encoding::Json), ("msgpack", Encoding::MessagePack)] {
        let bytes = encoding.write(&frame);
        println!("a frame of {} messages takes {} bytes of {name}", frame.len(), bytes.len());
        c.bench_function(&format!("read/{name}"), |b| {
            b.iter(|| encoding.read::<ClientMessage>(black_box(&bytes)).expect("a frame"))
        });
        c.bench_function(&format!("write/{name}"), |b| b.iter(|| encoding.write(black_box(&frame))));
    }
}

/// Frames of one client over a city, whose requests come at once.
fn frames(c: &mut Criterion) {
    let world = city(&CityParams { blocks_x: 20, blocks_y: 20, ..CityParams::default() }).expect("a city");
    let uri = |rep: RepId| world.uri(rep).into_owned();
    let of = SessionWorld { name: "city", identity: "0", base: "/", tree: &world.tree, uri: &uri, up: world.up };
    let hello = Hello {
        version: VERSION,
        world: "city".to_owned(),
        memory_bytes: 16 << 20,
        refinement: Refinement::Partial,
        policy: None,
        mode: Mode::Drive,
        resume: None,
        resident: Vec::new(),
        client: None,
        link: None,
    };
    let (mut session, _) = Session::open("bench".to_owned(), of, &SessionLimits::default(), &hello).expect("a session");
    let (mut tick, mut coming, mut total) = (0u64, Vec::new(), 0u64);
    c.bench_function("session/frame", |b| {
        b.iter(|| {
            let now = tick * TICK_NS;
            let mut frame: Vec<ClientMessage> = Vec::new();
            for rep in coming.drain(..) {
                total += world.tree.wire_bytes(RepId(rep));
                frame.push(ClientMessage::Responded(Event { t_ns: now, rep }));
                frame.push(ClientMessage::Completed(Event { t_ns: now, rep }));
            }
            frame.push(ClientMessage::Progress(Progress { t_ns: now, total_bytes: total, in_flight_bytes: 0 }));
            frame.extend(typical(now, (tick % 6000) as f64 * 0.1).pop());
            let answers = session.frame(now, &frame);
            for answer in &answers {
                match answer {
                    ServerMessage::Fetch(fetch) => coming.push(fetch.rep),
                    ServerMessage::Cancel { rep } => coming.retain(|under_way| under_way != rep),
                    _ => {}
                }
            }
            tick += 1;
            answers.len()
        })
    });
    println!("the session keeps {} bytes", session.heap_bytes());
}

criterion_group!(benches, encodings, frames);
criterion_main!(benches);
