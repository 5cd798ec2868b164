//! Names of the OpenGL backends.

use std::fmt;

/// Backend that provides an OpenGL context.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum OpenGlBackend {
    /// EGL without any surface (Mesa), the first choice.
    EglSurfaceless,
    /// EGL with a pixel buffer, on the first device that offers one (for instance a headless GPU).
    EglPbuffer,
    /// Mesa's software renderer in memory, the last choice.
    OsMesa,
}

impl OpenGlBackend {
    /// Every OpenGL backend, in the order in which they are tried.
    pub const ALL: [Self; 3] = [Self::EglSurfaceless, Self::EglPbuffer, Self::OsMesa];
}

impl fmt::Display for OpenGlBackend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EglSurfaceless => "EGL (surfaceless)",
            Self::EglPbuffer => "EGL (pixel buffer)",
            Self::OsMesa => "OSMesa",
        })
    }
}
