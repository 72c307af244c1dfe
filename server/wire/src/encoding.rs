//! Frames as bytes: a list of messages, as JSON text or as MessagePack with the same names.
//!
//! A frame from a client is bounded before it is parsed: in size by [`FRAME_BYTES_MAX`] or what the reader gives, in depth
//! by [`DEPTH_MAX`]. Parsing takes memory in proportion to its size.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Bytes of a frame that [`Encoding::read`] takes: an announced path of 4096 views takes about 0.7 MB of JSON.
pub const FRAME_BYTES_MAX: usize = 1 << 20;

/// Levels of lists and maps within each other in a frame; messages have six.
pub const DEPTH_MAX: usize = 16;

/// How frames are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// JSON, in text frames.
    #[default]
    Json,
    /// MessagePack, in binary frames.
    MessagePack,
}

/// Why a frame cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FrameError {
    /// It is no JSON list of messages.
    #[error("the frame is no list of messages: {0}; expected JSON such as [{{\"type\":\"bye\"}}]")]
    Json(#[from] serde_json::Error),
    /// It is no MessagePack list of messages.
    #[error("the frame is no list of messages: {0}; expected MessagePack with the names of the JSON form")]
    MessagePack(#[from] rmp_serde::decode::Error),
    /// Bytes after the list.
    #[error("{0} bytes follow the list of messages; expected its end")]
    Trailing(usize),
    /// Too long.
    #[error("the frame has {bytes} bytes; expected at most {most}")]
    Size {
        /// As given.
        bytes: usize,
        /// Allowed.
        most: usize,
    },
    /// Lists and maps within each other beyond [`DEPTH_MAX`].
    #[error("byte {at} of the frame lies more than {DEPTH_MAX} lists and maps deep; expected at most that")]
    Depth {
        /// Where.
        at: usize,
    },
}

impl Encoding {
    /// Reads a frame of at most [`FRAME_BYTES_MAX`] bytes.
    ///
    /// # Errors
    /// What is no list of messages of this version, or exceeds a bound.
    pub fn read<M: DeserializeOwned>(self, frame: &[u8]) -> Result<Vec<M>, FrameError> {
        self.read_at_most(frame, FRAME_BYTES_MAX)
    }

    /// Reads a frame of at most `most` bytes.
    ///
    /// # Errors
    /// What is no list of messages of this version, or exceeds a bound.
    pub fn read_at_most<M: DeserializeOwned>(self, frame: &[u8], most: usize) -> Result<Vec<M>, FrameError> {
        if frame.len() > most {
            return Err(FrameError::Size { bytes: frame.len(), most });
        }
        match self {
            Encoding::Json => {
                check_depth(frame)?;
                Ok(serde_json::from_slice(frame)?)
            }
            Encoding::MessagePack => {
                let mut rest = frame;
                let mut deserializer = rmp_serde::Deserializer::new(&mut rest);
                deserializer.set_max_depth(DEPTH_MAX);
                let messages = Vec::<M>::deserialize(&mut deserializer)?;
                if rest.is_empty() { Ok(messages) } else { Err(FrameError::Trailing(rest.len())) }
            }
        }
    }

    /// Writes a frame.
    pub fn write<M: Serialize>(self, messages: &[M]) -> Vec<u8> {
        match self {
            Encoding::Json => serde_json::to_vec(messages).expect("messages have string keys and finite numbers"),
            Encoding::MessagePack => rmp_serde::to_vec_named(messages).expect("messages fit MessagePack"),
        }
    }
}

/// Refuses JSON text with more than [`DEPTH_MAX`] brackets open at once; brackets in strings do not count.
fn check_depth(text: &[u8]) -> Result<(), FrameError> {
    let (mut depth, mut in_string, mut escaped) = (0usize, false, false);
    for (at, &byte) in text.iter().enumerate() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => in_string = !in_string,
            _ if in_string => {}
            b'[' | b'{' => {
                depth += 1;
                if depth > DEPTH_MAX {
                    return Err(FrameError::Depth { at });
                }
            }
            b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
    Ok(())
}
