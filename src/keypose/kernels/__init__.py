"""The hot loops, compiled with Numba to explicit SIMD code: arrays in, arrays out, quaternions wxyz.

Functions of other packages check their arguments; the entries here only make sure that types and sizes are safe to
run on. Importing this package loads nothing; each module loads Numba when it is first used.

    text     numbers of text files, both ways
    fk       forward kinematics of whole clips
    clips    clips in the form that sampling reads
    sample   sampling and blending clips for crowds and single characters
    slerp    spherical interpolation in two layouts
    skin     linear-blend skinning
    euler    Euler angles to quaternions and back
    encode, decode   compressed clips of the run time
    curves   thousands of curves of every kind
    limbs    two-bone limbs of crowds
    fullbody*   whole bodies: tables, tasks, limits, steps, and one pose by one call
    graph*, crowd, skincrowd   animation graphs of crowds, and their skins
    sight, collapse   rays through meshes, and fewer triangles
    meshopt  compressed buffers of glTF
    vectors, rotations, words, wordvectors, runtime   what they are made of
"""
