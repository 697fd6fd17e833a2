//! Light fields and layer stacks on disk: folders, EXR, NPY, quilts.
