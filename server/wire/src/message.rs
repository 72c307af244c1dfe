//! The messages, version [`VERSION`].
//!
//! A frame on the socket holds a list of messages, JSON text or MessagePack bytes with the same names. Times of the client
//! are nanoseconds since its session began, on the client's own clock; times of the server are on the same clock, as the
//! server knows it. Representations go by their number in the world. The server reads a frame whole, lets the scheduler
//! observe the last view in it, and answers with what to do.

use crate::finite;
use serde::{Deserialize, Serialize};

/// Version of the messages. Raised when a field changes its meaning or goes away; a `hello` of another is refused.
pub const VERSION: u32 = 1;

/// What a client says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum ClientMessage {
    /// Begins or resumes a session; the first message of a connection, and only that.
    Hello(Box<Hello>),
    /// Where the cameras are.
    View(Views),
    /// The first byte of a response came.
    Responded(Event),
    /// Bytes received so far.
    Progress(Progress),
    /// The last byte came; it will be decoded.
    Arrived(Event),
    /// It can be shown.
    Completed(Event),
    /// It could not be fetched or decoded.
    Failed(Failure),
    /// The client has aborted a request or let go what was there, without being told to.
    Dropped(Event),
    /// Where the camera will go: a `flyTo`, a tour.
    Path(Path),
    /// Changes what can be changed during a session.
    Settings(Settings),
    /// The client is leaving for good: the session need not be kept.
    Bye,
}

/// Begins or resumes a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Hello {
    /// [`VERSION`].
    pub version: u32,
    /// Name of the world, as the server lists it.
    pub world: String,
    /// Memory for everything that is fetched, bytes.
    pub memory_bytes: u64,
    /// When children may be drawn.
    #[serde(default)]
    pub refinement: Refinement,
    /// Policy with its options, such as `foresight:alpha=0.8`; the server's default if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// What the server's answers are for.
    #[serde(default)]
    pub mode: Mode,
    /// A session to go on with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resume: Option<String>,
    /// What the client holds and can show: at the start, and after a break of the connection. Requests that were under way
    /// when the connection broke are over unless the first frame after the `hello` says of them that they have `responded`,
    /// `arrived` or `completed`, be it once more.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub resident: Vec<u32>,
    /// What the client is or where: link estimates are kept under it, for the next session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub client: Option<String>,
    /// What the client already knows of its link.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkGuess>,
}

/// When children may be drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Refinement {
    /// Beside their parent, each by itself.
    #[default]
    Partial,
    /// Only when all are there.
    Atomic,
}

/// What the server's answers are for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The client does what it is told.
    #[default]
    Drive,
    /// The client fetches by its own rules and reports that; what it is told is meant to warm its cache. What it holds is
    /// what it reports, within `memory_bytes` for its cache.
    Warm,
    /// Decisions are made and recorded, and not sent.
    Shadow,
}

/// What the client already knows of its link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LinkGuess {
    /// Bytes per second.
    #[serde(deserialize_with = "finite::number")]
    pub rate: f64,
    /// Seconds.
    #[serde(deserialize_with = "finite::number")]
    pub latency_s: f64,
}

/// Where the cameras are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Views {
    /// When, ns.
    pub t_ns: u64,
    /// One or several; several share the link and the memory, each counting by its weight.
    pub cameras: Vec<Camera>,
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// In the world, metres.
    #[serde(deserialize_with = "finite::numbers")]
    pub position: [f64; 3],
    /// x, y, z, w of the unit quaternion that turns a camera looking along −z with +y up into the world.
    #[serde(deserialize_with = "finite::numbers")]
    pub orientation: [f64; 4],
    /// Vertical field of view, radians.
    #[serde(deserialize_with = "finite::number")]
    pub fov_y: f64,
    /// Width and height, pixels.
    pub viewport: [u32; 2],
    /// How much it counts among several; 1 if absent.
    #[serde(default = "one", skip_serializing_if = "is_one", deserialize_with = "finite::number")]
    pub weight: f64,
}

fn one() -> f64 {
    1.0
}

fn is_one(weight: &f64) -> bool {
    *weight == 1.0
}

/// Something happened to a representation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Event {
    /// When, ns.
    pub t_ns: u64,
    /// To what.
    pub rep: u32,
}

/// Bytes received.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// When, ns.
    pub t_ns: u64,
    /// Since the session began, over all requests.
    pub total_bytes: u64,
    /// Of these, of requests still under way.
    pub in_flight_bytes: u64,
}

/// A request or its decoding failed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Failure {
    /// When, ns.
    pub t_ns: u64,
    /// Of what.
    pub rep: u32,
    /// Why, for the log.
    pub reason: String,
}

/// Where the camera will go.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Path {
    /// Views in order of time.
    pub views: Vec<Waypoint>,
}

/// A view of a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Waypoint {
    /// When, ns.
    pub t_ns: u64,
    /// The view.
    pub camera: Camera,
}

/// What can be changed during a session; what is absent stays.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Memory for everything that is fetched, bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_bytes: Option<u64>,
    /// Policy with its options.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// What the answers are for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<Mode>,
}

/// What the server says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ServerMessage {
    /// The session has begun or goes on.
    Welcome(Box<Welcome>),
    /// Request this.
    Fetch(Fetch),
    /// Abort this request; what has arrived of it meanwhile, or all of it, is freed. No event is expected of it.
    Cancel {
        /// Which.
        rep: u32,
    },
    /// Free this, if it is held.
    Discard {
        /// Which.
        rep: u32,
    },
    /// Nothing to do before this time, or before something happens.
    Wait {
        /// Until when, ns.
        until_ns: u64,
        /// Why, where that is not plain.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        because: Option<String>,
    },
    /// What the scheduler believes; at most once a second.
    Estimates(Estimates),
    /// The server drives no more, or again: until then the client fetches by its own rules.
    Switch {
        /// Whether it drives.
        driving: bool,
    },
    /// Something was wrong.
    Error(Error),
}

/// The session has begun or goes on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Welcome {
    /// [`VERSION`].
    pub version: u32,
    /// To resume with.
    pub session: String,
    /// Whether the session that was asked for went on; otherwise a new one has begun with what the client holds.
    pub resumed: bool,
    /// Name of the world.
    pub world: String,
    /// Hash of its content.
    pub identity: String,
    /// What the URIs of `fetch` are relative to: a path on this server.
    pub base: String,
    /// Number of representations.
    pub representations: u64,
    /// Away from the ground, unit length.
    pub up: [f64; 3],
    /// Corners of what there is, metres.
    pub bounds: [[f64; 3]; 2],
    /// The policy with its options.
    pub policy: String,
    /// Whether the server drives now.
    pub driving: bool,
}

/// Request a representation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Fetch {
    /// What.
    pub rep: u32,
    /// From where, relative to the welcome's `base`.
    pub uri: String,
    /// Bytes on the wire.
    pub wire_bytes: u64,
    /// Bytes of memory when decoded.
    pub decoded_bytes: u64,
    /// Urgency as in RFC 9218, 0 the most urgent. In view now: 0 where nothing else is there or on its way, 1 where
    /// something better comes, 2 if it is mostly for the worst case; not in view: from 3, all for the predicted path, to 7, all for the worst
    /// case.
    pub urgency: u8,
    /// When it should be there to be worth what it was chosen for, ns: the arrival that the choice counted on.
    pub deadline_ns: u64,
    /// Share of its gain that the predicted path has; the rest is the worst case's. Absent where the policy cannot say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predicted_share: Option<f64>,
    /// It is decoded after this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<u32>,
    /// Free these when its last byte has come, before it is decoded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub discard_on_arrival: Vec<u32>,
}

/// What the scheduler believes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Estimates {
    /// When, ns.
    pub t_ns: u64,
    /// Of the link, bytes per busy second.
    pub rate: f64,
    /// Of the link, seconds.
    pub latency_s: f64,
    /// Bytes of the client's memory in use.
    pub used_bytes: u64,
    /// Quality of the present view by what is resident; absent where nothing is in view.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<f64>,
    /// Trust in the prediction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alpha: Option<f64>,
    /// What is proven about the last choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
}

/// What is proven about the last choice.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Certificate {
    /// Share of the best ratio that it may miss at most.
    pub regret: f64,
    /// Whether it was cut short.
    pub cut_short: bool,
}

/// Something was wrong.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Error {
    /// A word that stays.
    pub code: ErrorCode,
    /// What was found and what was expected.
    pub message: String,
    /// The connection is closed after it.
    pub fatal: bool,
}

/// What kind of thing was wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ErrorCode {
    /// The frame is no list of messages.
    Malformed,
    /// `hello` of another version.
    Version,
    /// A message where it is not expected: before `hello`, a second `hello`.
    Order,
    /// No such world.
    World,
    /// A value that has no meaning.
    Value,
    /// An event that contradicts what is known: of something that was not requested.
    Event,
    /// Too many sessions, or messages too large or too many.
    Limit,
    /// The server is shutting down.
    Shutdown,
    /// The server is at fault.
    Internal,
}
