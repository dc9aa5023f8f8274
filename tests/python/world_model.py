"""A checkpoint of the world model read by a stranger: PyTorch computes the latents and the rollouts
that our program computed, and ONNX Runtime the encoder that PyTorch exports.

    python3 world_model.py CHECKPOINT VECTORS OUT.onnx

CHECKPOINT is a folder with model.safetensors and config.json. VECTORS is a safetensors file of float32
with frames [n, 100, 100, 3] (bytes 0..255), z_c and z_u [n, 16], actions [n, h, 2] and rollout
[n, h, 16]. Exits with 1 where a value is off by more than 1e-4 of the largest.
"""

import json
import struct
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

TOLERANCE = 1e-4
TYPES = {"F32": np.float32, "F64": np.float64}


def read_safetensors(path: Path) -> dict[str, torch.Tensor]:
    """The file's tensors: eight bytes of length, a JSON header, the numbers."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    header.pop("__metadata__", None)
    tensors = {}
    for name, entry in header.items():
        first, last = (8 + length + offset for offset in entry["data_offsets"])
        values = np.frombuffer(data[first:last], TYPES[entry["dtype"]]).reshape(entry["shape"])
        tensors[name] = torch.from_numpy(values.copy())
    return tensors


class Encoder(nn.Module):
    """Pictures [n, 100, 100, 3], bytes as float32, to z_c and z_u [n, 16]."""

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        for name, values in tensors.items():
            if values.dtype == torch.float32:
                self.register_buffer(name.replace(".", "_"), values)
        self.has_colour = "colour.weight" in tensors
        self.is_gated = tensors["head_c.weight"].shape[1] == 512

    def read(self, frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The trunk's input [n, 3, 100, 100], and q, the missing share of each colour [n, 3, 1]."""
        pixels = frames.reshape(-1, 10000, 3).transpose(1, 2) / 255.0
        if self.has_colour:
            bodies = torch.relu(self.colour_weight @ pixels + self.colour_bias[:, None])
            empty = torch.zeros_like(bodies[:, :1])
            pixels = torch.cat([bodies[:, :1], empty, bodies[:, 1:]], dim=1)
        whole, own = self.input_whole_mass[:, None], pixels.sum(2, keepdim=True)
        centred = (whole > 0) & (own > 0)
        ratio = torch.where(centred, whole / torch.clamp(own, min=1e-6), torch.ones_like(own))
        missing = torch.where(centred, 1.0 - own / torch.clamp(whole, min=1e-6), torch.zeros_like(own))
        x = pixels * ratio / self.input_scale[:, None]
        return x.reshape(-1, 3, 100, 100), missing

    def forward(self, frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x, missing = self.read(frames)
        for n, (stride, padding) in enumerate([(4, 4), (2, 2), (2, 2), (2, 2)], start=1):
            weight, bias = getattr(self, f"conv{n}_weight"), getattr(self, f"conv{n}_bias")
            x = nn.functional.conv2d(x, weight, bias, stride=stride, padding=padding)
            x = nn.functional.leaky_relu(x, 0.1)
        h = nn.functional.linear(x.flatten(1), self.fc_weight, self.fc_bias)
        z_u = nn.functional.linear(h, self.head_u_weight, self.head_u_bias)
        if self.is_gated:
            h = torch.cat([h, h * missing[:, 0]], dim=1)
        return nn.functional.linear(h, self.head_c_weight, self.head_c_bias), z_u


class VoteEncoder(nn.Module):
    """The learned encoder: pictures [n, 100, 100, 3], bytes as float32, to z_c and z_u [n, 16]."""

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        for name, values in tensors.items():
            if values.dtype == torch.float32:
                self.register_buffer(name.replace(".", "_"), values)
        self.scale = float(tensors["scale"][0])
        centres = 4.0 * torch.arange(25.0) + 0.5
        grid = torch.stack(torch.meshgrid(centres, centres, indexing="xy"))
        self.register_buffer("grid", grid.reshape(1, 1, 2, 625))

    def forward(self, frames: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = frames.permute(0, 3, 1, 2) / 128.0
        for n, (stride, padding, dilation) in enumerate([(2, 2, 1), (2, 1, 1), (1, 1, 1), (1, 2, 2)], start=1):
            weight, bias = getattr(self, f"votes_conv{n}_weight"), getattr(self, f"votes_conv{n}_bias")
            x = nn.functional.conv2d(x, weight, bias, stride=stride, padding=padding, dilation=dilation)
            x = nn.functional.leaky_relu(x, 0.1)
        maps = nn.functional.conv2d(x, self.votes_vote_weight, self.votes_vote_bias).reshape(-1, 2, 3, 625)
        weights = torch.softmax(8.0 * maps[:, :, :1], dim=3)
        places = (weights * (self.grid + 4.0 * maps[:, :, 1:])).sum(3)
        y = self.scale * (places / 100.0 - 0.5)
        return y[:, 0] @ self.plane_c.T, y[:, 1] @ self.plane_u.T


def rollout(tensors: dict[str, torch.Tensor], z_c: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """z_c predicted along the actions from rest: both history frames are the first one."""
    psi = [tensors[f"predictor.{name}"] for name in ("c0", "c1", "ca")]
    now = before = z_c.double()
    steps = []
    for action in actions.double().unbind(1):
        now, before = now @ psi[0].T + before @ psi[1].T + action @ psi[2].T, now
        steps.append(now)
    return torch.stack(steps, 1)


def check(name: str, found: np.ndarray, wanted: torch.Tensor) -> bool:
    wanted = wanted.double().numpy()
    off = np.abs(found.astype(np.float64) - wanted).max() / np.abs(wanted).max()
    print(f"{name}: off by {off:.1e} of the largest value")
    return bool(off <= TOLERANCE)


def main() -> int:
    checkpoint, vectors, onnx = (Path(argument) for argument in sys.argv[1:])
    torch.set_num_threads(1)
    config = json.loads((checkpoint / "config.json").read_text())
    if config["format"] != "crpl-world-model/1":
        print(f"config.json has format {config['format']}", file=sys.stderr)
        return 1
    tensors, ours = read_safetensors(checkpoint / "model.safetensors"), read_safetensors(vectors)
    is_learned = "votes.vote.weight" in tensors
    encoder = (VoteEncoder if is_learned else Encoder)(tensors).eval()
    with torch.no_grad():
        z_c, z_u = encoder(ours["frames"])
        ahead = rollout(tensors, ours["z_c"], ours["actions"])
        names = {"input_names": ["frames"], "output_names": ["z_c", "z_u"]}
        axes = {name: {0: "n"} for name in ("frames", "z_c", "z_u")}
        torch.onnx.export(encoder, ours["frames"][:2], str(onnx), dynamic_axes=axes, **names)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(onnx), options, providers=["CPUExecutionProvider"])
    exported = session.run(["z_c", "z_u"], {"frames": ours["frames"].numpy()})
    good = [
        check("PyTorch z_c", z_c.numpy(), ours["z_c"]),
        check("PyTorch z_u", z_u.numpy(), ours["z_u"]),
        check("PyTorch rollout", ahead.numpy(), ours["rollout"]),
        check("ONNX Runtime z_c", exported[0], ours["z_c"]),
        check("ONNX Runtime z_u", exported[1], ours["z_u"]),
    ]
    print(f"ONNX Runtime: {milliseconds(session, ours['frames'][:1].numpy()):.4f} ms a frame")
    return 0 if all(good) else 1


def milliseconds(session: onnxruntime.InferenceSession, frame: np.ndarray) -> float:
    """Median time of one frame on one thread, of 9 rounds of 60."""
    rounds = []
    for _ in range(9):
        start = time.perf_counter()
        for _ in range(60):
            session.run(["z_c", "z_u"], {"frames": frame})
        rounds.append((time.perf_counter() - start) / 60 * 1e3)
    return sorted(rounds)[len(rounds) // 2]


if __name__ == "__main__":
    sys.exit(main())
