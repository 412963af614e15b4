"""Wavefront OBJ: the vertices and triangles of one frame, as text."""

from dancedata.formats.body_mesh import Float32, Int32


def obj_text(vertices: Float32, faces: Int32) -> str:
    """Return a mesh as text, six decimals, with the vertices in their order; metres, +Y up."""
    places = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in vertices.tolist())
    return places + "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())
