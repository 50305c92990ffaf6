"""Actor and encoder as ONNX graphs, written node by node.

PyTorch's exporters need a further package or are on their way out, and both change with every release. These networks
are a handful of operators, so their graphs are built here from ONNX's own helpers: they depend on nothing else, and
are old enough in operator set and file version for any runtime since 2022.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from ogmp_sb3.guidance.latent import FEATURES, LatentEncoder

Shape = tuple[int | str, ...]

OPSET = 17
FILE_VERSION = 8


class _Graph:
    """Collects the nodes and constants of a graph in which every value is named."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: np.ndarray) -> str:
        """A constant; whole numbers stay whole, all else becomes float32."""
        kind = np.int64 if value.dtype.kind == "i" else np.float32
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, dtype=kind), name))
        return name

    def add(self, operator: str, inputs: list[str], *outputs: str, **attributes: Any) -> str:
        """An operator; returns the name of its first output."""
        self.nodes.append(helper.make_node(operator, inputs, list(outputs), **attributes))
        return outputs[0]

    def normalise(self, x: str, mean: np.ndarray, std: np.ndarray) -> str:
        """``(x - mean) / std``."""
        centred = self.add("Sub", [x, self.constant("mean", mean)], f"{x}_centred")
        return self.add("Div", [centred, self.constant("std", std)], f"{x}_normalised")

    def clip(self, x: str, limit: float, output: str) -> str:
        """``x`` between ``-limit`` and ``limit``."""
        low, high = (self.constant(f"{output}_{end}", np.array(s * limit)) for end, s in (("low", -1), ("high", 1)))
        return self.add("Clip", [x, low, high], output)

    def linear(self, name: str, x: str, layer: Any) -> str:
        """A PyTorch ``nn.Linear``."""
        weights = (self.constant(f"{name}_{key}", w.detach().numpy()) for key, w in layer.named_parameters())
        return self.add("Gemm", [x, *weights], name, transB=1)

    def lstm(self, name: str, x: str, weights: tuple[np.ndarray, ...], states: tuple[str, ...] = ()) -> str:
        """One LSTM layer; its outputs are ``<name>``, ``<name>_h`` and ``<name>_c``.

        :param x: sequence of shape (steps, 1, inputs)
        :param weights: PyTorch's, of shapes (4 hidden, inputs), (4 hidden, hidden) and (4 hidden,)
        :param states: initial hidden and cell state, shape (1, 1, hidden); zero if left out
        :return: the output sequence, shape (steps, 1, hidden)
        """
        inputs, recurrent, bias = (_reordered(w) for w in weights)
        operands = [
            x,
            self.constant(f"{name}_W", inputs[None]),
            self.constant(f"{name}_R", recurrent[None]),
            self.constant(f"{name}_B", np.concatenate([bias, np.zeros_like(bias)])[None]),
            *(["", *states] if states else []),  # the empty name stands for the lengths of sequences
        ]
        directed = self.add(
            "LSTM", operands, f"{name}_directed", f"{name}_h", f"{name}_c", hidden_size=recurrent.shape[1]
        )
        return self.squeeze(directed, 1, name)

    def squeeze(self, x: str, axis: int, output: str) -> str:
        """``x`` without an axis of length 1."""
        return self.add("Squeeze", [x, self.constant(f"{output}_axis", np.array([axis]))], output)

    def unsqueeze(self, x: str, axis: int, output: str) -> str:
        """``x`` with a further axis of length 1."""
        return self.add("Unsqueeze", [x, self.constant(f"{output}_axis", np.array([axis]))], output)

    def model(self, name: str, inputs: dict[str, Shape], outputs: dict[str, Shape]) -> onnx.ModelProto:
        """The finished model; a shape may name a length that varies."""
        graph_inputs, graph_outputs = (
            [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in values.items()]
            for values in (inputs, outputs)
        )
        graph = helper.make_graph(self.nodes, name, graph_inputs, graph_outputs, self.constants)
        model = helper.make_model(graph, producer_name="ogmp_sb3", opset_imports=[helper.make_opsetid("", OPSET)])
        model.ir_version = FILE_VERSION
        onnx.checker.check_model(model, full_check=True)
        return model


def _reordered(weights: np.ndarray) -> np.ndarray:
    """Gates in ONNX's order input, output, forget, cell, from PyTorch's input, forget, cell, output."""
    i, f, g, o = np.split(weights, 4)
    return np.concatenate([i, o, f, g])


def actor_model(policy: Any) -> onnx.ModelProto:
    """The normaliser and the actor: one control step of ``policy.predict(deterministic=True)``.

    Inputs ``obs`` (1, n), ``h`` and ``c`` (layers, 1, hidden); outputs ``action`` (1, m) in [-1, 1], ``h_next`` and
    ``c_next``. ONNX wants every value to have a name of its own, so the next states cannot be called ``h`` and ``c``.

    :param policy: a :class:`~ogmp_sb3.sb3.policy.LstmPolicy`
    """
    normaliser, memory, head = policy.features_extractor, policy.lstm_actor, policy.action_net
    size, layers, hidden, actions = normaliser.features_dim, memory.num_layers, memory.hidden_size, head.out_features
    lstm = memory.lstm if policy.input_layers else memory
    tensors = {name: tensor.detach().numpy() for name, tensor in lstm.named_parameters()}
    mean, variance, floor = (t.numpy() for t in (normaliser.mean, normaliser.variance, normaliser.floor))

    graph = _Graph()
    x = graph.normalise("obs", mean, np.maximum(np.sqrt(variance), floor))
    x = graph.clip(x, normaliser.clip, "features")
    for k in range(len(policy.input_layers)):
        x = graph.add("Elu", [graph.linear(f"layer_{k}", x, memory.layers[2 * k])], f"layer_{k}_units")
    x = graph.unsqueeze(x, 0, "sequence")
    graph.constant("one_each", np.ones(layers, dtype=int))
    for state in ("h", "c"):
        graph.add("Split", [state, "one_each"], *(f"{state}_{k}" for k in range(layers)), axis=0)
    for k in range(layers):
        bias = tensors[f"bias_ih_l{k}"] + tensors[f"bias_hh_l{k}"]
        weights = (tensors[f"weight_ih_l{k}"], tensors[f"weight_hh_l{k}"], bias)
        x = graph.lstm(f"lstm_{k}", x, weights, (f"h_{k}", f"c_{k}"))
    for state in ("h", "c"):
        graph.add("Concat", [f"lstm_{k}_{state}" for k in range(layers)], f"{state}_next", axis=0)
    graph.clip(graph.linear("mean_action", graph.squeeze(x, 0, "output"), head), 1.0, "action")
    state_shape = (layers, 1, hidden)
    return graph.model(
        "actor",
        {"obs": (1, size), "h": state_shape, "c": state_shape},
        {"action": (1, actions), "h_next": state_shape, "c_next": state_shape},
    )


def encoder_model(encoder: LatentEncoder) -> onnx.ModelProto:
    """The encoder of a reference, its normaliser included.

    Input ``features`` (knots, 13), of :func:`~ogmp_sb3.guidance.latent.reference_features`; output ``latent`` (1,
    latent size).
    """
    first, second = (tuple(w.T for w in encoder.weights[k : k + 3]) for k in (0, 3))
    graph = _Graph()
    x = graph.unsqueeze(graph.normalise("features", encoder.mean, encoder.std), 1, "sequence")
    x = graph.add("Relu", [graph.lstm("lstm_in", x, first)], "hidden")
    graph.lstm("lstm_out", x, second)
    graph.squeeze("lstm_out_h", 0, "latent")
    return graph.model("encoder", {"features": ("knots", FEATURES)}, {"latent": (1, encoder.size)})
