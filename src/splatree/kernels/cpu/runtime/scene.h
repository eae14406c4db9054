// The structs of Python that glue takes. Each is an object under the name of its class, so that the generated stub names the
// class and the type checker holds callers to it. Fields are read by name, with structs.h.
#pragma once
#include "cpu/runtime/structs.h"

namespace splatree {

inline bool is_any(PyObject*) {
  return true;
}  // the type checker has looked; a field that is missing is an error when it is read

#define SPLATREE_STRUCT(Name, path)                   \
  struct Name : nb::object {                          \
    NB_OBJECT_DEFAULT(Name, nb::object, path, is_any) \
  }

namespace py {

SPLATREE_STRUCT(Gaussians, "splatree.scene.gaussians.Gaussians");
SPLATREE_STRUCT(GaussianTree, "splatree.scene.tree.GaussianTree");
SPLATREE_STRUCT(BlockIndex, "splatree.scene.tree.BlockIndex");
SPLATREE_STRUCT(Sides, "splatree.scene.clusters.Sides");
SPLATREE_STRUCT(View, "splatree.scene.view.View");
SPLATREE_STRUCT(Splats, "splatree.scene.frame.Splats");
SPLATREE_STRUCT(TileBins, "splatree.scene.frame.TileBins");
SPLATREE_STRUCT(Picture, "splatree.scene.frame.Picture");
SPLATREE_STRUCT(PictureGradients, "splatree.scene.gradients.PictureGradients");
SPLATREE_STRUCT(SplatGradients, "splatree.scene.gradients.SplatGradients");
SPLATREE_STRUCT(GaussianGradients, "splatree.scene.gradients.GaussianGradients");
SPLATREE_STRUCT(SquareRule, "splatree.kernels.reference.square.SquareRule");
SPLATREE_STRUCT(PackedView, "splatree.kernels.cpu.frame.view.PackedView");
SPLATREE_STRUCT(PackedQuestion, "splatree.kernels.cpu.frame.question.PackedQuestion");
SPLATREE_STRUCT(PackedSides, "splatree.kernels.cpu.frame.question.PackedSides");

}  // namespace py

// A number of a struct.
template <class T>
T number(nb::handle owner, const char* name) {
  return nb::cast<T>(owner.attr(name));
}

}  // namespace splatree
