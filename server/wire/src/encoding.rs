//! Frames as bytes: a list of messages, as JSON text or as MessagePack with the same names.

use serde::Serialize;
use serde::de::DeserializeOwned;

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
}

impl Encoding {
    /// Reads a frame.
    ///
    /// # Errors
    /// What is no list of messages of this version.
    pub fn read<M: DeserializeOwned>(self, frame: &[u8]) -> Result<Vec<M>, FrameError> {
        match self {
            Encoding::Json => Ok(serde_json::from_slice(frame)?),
            Encoding::MessagePack => Ok(rmp_serde::from_slice(frame)?),
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
