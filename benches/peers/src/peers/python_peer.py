"""One run of a simplifier that comes as a Python package.

    python_peer.py TOOL                            prints the version of its package
    python_peer.py TOOL VERTICES TRIANGLES TARGET  reads positions (f32) and triangles (u32) from stdin; writes a line of
                                                   JSON, then the positions and triangles of the result

Only the call that simplifies is timed, on data in the form it wants. The peak is that of the resident memory during the
call, beyond what was resident before it.
"""

import importlib.metadata
import json
import sys
import time

import numpy as np


def fast_simplification(points, triangles, target):
    # its thresholds are absolute: on a model with a diagonal of 1 the aggressiveness of 3 gives results like those of other
    # quadrics, which its default of 7 does not
    import fast_simplification

    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    points = (points / diagonal).astype(np.float32)
    triangles = triangles.astype(np.int32)

    def simplify():
        return fast_simplification.simplify(points, triangles, target_count=target, agg=3)

    def result(answer):
        return answer[0] * diagonal, answer[1]

    return simplify, result


def vtk(points, triangles, target):
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkFiltersCore import vtkQuadricDecimation

    vertices = vtkPoints()
    vertices.SetData(numpy_to_vtk(points, deep=True))
    cells = vtkCellArray()
    starts = np.arange(len(triangles) + 1, dtype=np.int64) * 3
    corners = triangles.astype(np.int64).ravel()
    cells.SetData(numpy_to_vtkIdTypeArray(starts, deep=True), numpy_to_vtkIdTypeArray(corners, deep=True))
    mesh = vtkPolyData()
    mesh.SetPoints(vertices)
    mesh.SetPolys(cells)
    quadric = vtkQuadricDecimation()
    quadric.SetInputData(mesh)
    quadric.SetTargetReduction(1 - target / len(triangles))

    def result(_):
        output = quadric.GetOutput()
        faces = vtk_to_numpy(output.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        return vtk_to_numpy(output.GetPoints().GetData()), faces

    return quadric.Update, result


# by name: package, and a function that prepares the call and one that brings its answer into our form
TOOLS = {"fast-simplification": ("fast-simplification", fast_simplification), "vtk": ("vtk", vtk)}


def memory(key):
    """Resident memory now (VmRSS) or at its peak (VmHWM), in bytes."""
    with open("/proc/self/status", encoding="ascii") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith(key))


def forget_peak():
    """Sets the peak of the resident memory to what is resident now; False where the system cannot do it."""
    try:
        with open("/proc/self/clear_refs", "w", encoding="ascii") as refs:
            refs.write("5")
    except OSError:
        return False
    return True


def main():
    package, prepare = TOOLS[sys.argv[1]]
    if len(sys.argv) == 2:
        print(importlib.metadata.version(package))
        return
    vertices, triangles, target = map(int, sys.argv[2:])
    points = np.frombuffer(sys.stdin.buffer.read(12 * vertices), "<f4").reshape(-1, 3)
    faces = np.frombuffer(sys.stdin.buffer.read(12 * triangles), "<u4").reshape(-1, 3)
    simplify, result = prepare(points, faces, target)
    knows_peak = forget_peak()
    before = memory("VmRSS") if knows_peak else 0
    start = time.perf_counter()
    answer = simplify()
    seconds = time.perf_counter() - start
    peak = max(0, memory("VmHWM") - before) if knows_peak else None
    points, faces = result(answer)
    sizes = {"vertices": len(points), "triangles": len(faces)}
    print(json.dumps({"seconds": seconds, "peak_bytes": peak} | sizes), flush=True)
    sys.stdout.buffer.write(np.ascontiguousarray(points, "<f4").tobytes())
    sys.stdout.buffer.write(np.ascontiguousarray(faces, "<u4").tobytes())


if __name__ == "__main__":
    main()
