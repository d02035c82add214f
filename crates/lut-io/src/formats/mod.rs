//! Other people's files.

pub mod merl;
pub mod tensor_file;
