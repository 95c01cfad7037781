"""DINO's features and SAM's groups from local folders, on tiny untrained networks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from mesh_picture import cameras_around, draw_mesh, dumbbell
from mphygs.capture.errors import CaptureError
from mphygs.capture.features_dino import DinoFeatures
from mphygs.capture.mask_groups_sam import SamGroups, _distinct, _painted
from mphygs.capture.views import Photograph

transformers = pytest.importorskip("transformers", reason="transformers is not installed")


@pytest.fixture(scope="module")
def photograph() -> Photograph:
    camera = cameras_around(1, 40)[0].resized(48, 40)
    colour, mask = draw_mesh(camera, dumbbell())
    return Photograph(camera, colour.astype(np.float32), mask.astype(np.float32))


def saved(folder: Path, kind: str) -> Path:
    """A tiny network of random weights."""
    torch.manual_seed(0)
    small = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2}
    if kind == "dinov2":
        network = transformers.Dinov2Model(transformers.Dinov2Config(**small, image_size=28, patch_size=14))
    elif kind == "dinov3":
        config = transformers.DINOv3ViTConfig(
            **small, intermediate_size=32, image_size=32, patch_size=16, num_register_tokens=4
        )
        network = transformers.DINOv3ViTModel(config)
    elif kind == "sam":
        vision = transformers.SamVisionConfig(
            **small, output_channels=16, image_size=64, patch_size=16, window_size=2, global_attn_indexes=[0],
            num_pos_feats=8, mlp_dim=32,
        )  # fmt: skip
        prompt = transformers.SamPromptEncoderConfig(hidden_size=16, image_size=64, patch_size=16)
        decoder = transformers.SamMaskDecoderConfig(
            hidden_size=16, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=16
        )
        network = transformers.SamModel(
            transformers.SamConfig(
                vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
            )
        )
    else:
        backbone = transformers.Sam2HieraDetConfig(
            hidden_size=8, image_size=[64, 64], blocks_per_stage=[1, 1, 2, 1],
            embed_dim_per_stage=[8, 16, 32, 64],
            num_attention_heads_per_stage=[1, 1, 1, 1], window_size_per_stage=[4, 4, 4, 2],
            global_attention_blocks=[3], window_positional_embedding_background_size=[4, 4],
        )  # fmt: skip
        vision = transformers.Sam2VisionConfig(
            backbone_config=backbone, backbone_channel_list=[64, 32, 16, 8], fpn_hidden_size=16,
            backbone_feature_sizes=[[16, 16], [8, 8], [4, 4]],
        )  # fmt: skip
        prompt = transformers.Sam2PromptEncoderConfig(hidden_size=16, image_size=64, patch_size=16)
        decoder = transformers.Sam2MaskDecoderConfig(
            hidden_size=16, mlp_dim=32, num_attention_heads=2, iou_head_hidden_dim=16
        )
        network = transformers.Sam2Model(
            transformers.Sam2Config(
                vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
            )
        )
    network.save_pretrained(folder)
    return folder


@pytest.mark.parametrize("kind", ["dinov2", "dinov3"])
def test_dino_gives_a_unit_vector_for_every_patch(kind: str, tmp_path: Path, photograph: Photograph) -> None:
    extractor = DinoFeatures.of(saved(tmp_path / kind, kind))
    values = extractor.map_of(photograph)
    # 40 patches along the longest side, proportions kept
    assert values.shape == (33, 40, 16)
    assert np.linalg.norm(values, axis=2) == pytest.approx(1.0, abs=1e-5)
    # patches stand where they belong: what changes in the picture's right half changes them most
    other = photograph.colour.copy()
    other[:, 24:] = 1.0 - other[:, 24:]
    changed = np.abs(extractor.map_of(Photograph(photograph.camera, other, photograph.mask)) - values).sum(2)
    seen = photograph.mask[:, 24:].any()
    assert seen and changed[:, 24:].mean() > 2.0 * changed[:, :16].mean()


@pytest.mark.parametrize("kind", ["sam", "sam2"])
def test_sam_is_asked_about_points_on_the_object(kind: str, tmp_path: Path, photograph: Photograph) -> None:
    grouper = SamGroups.of(saved(tmp_path / kind, kind))
    # untrained: whatever it finds is let through
    grouper = SamGroups(grouper.network, points=6, score=-10.0, stability=-1.0, same=2.0, least=1e-9)
    found = grouper.groups_of(photograph)
    assert len(found) == 3
    for groups in found:
        assert groups.shape == photograph.mask.shape and groups.dtype == np.int32
        assert (groups[photograph.mask < 0.5] == -1).all()
        assert set(np.unique(groups)) <= set(range(-1, groups.max() + 1))


def test_masks_are_painted_and_the_same_ones_dropped() -> None:
    large, small = np.zeros((6, 6), bool), np.zeros((6, 6), bool)
    large[:, :4], small[:2, :2] = True, True
    kept = _distinct([(0.9, large), (0.95, small), (0.8, large.copy())], 0.8)
    assert len(kept) == 2 and kept[0] is small
    over = _painted([large, small], (6, 6))
    assert over[0, 0] == 1 and over[5, 0] == 0 and over[0, 5] == -1
    under = _painted([small, large], (6, 6))
    # hidden altogether: numbers without gaps
    assert set(np.unique(under)) == {-1, 0}


def test_a_folder_that_holds_something_else(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="holds no config.json"):
        DinoFeatures.of(tmp_path)
    other = saved(tmp_path / "sam", "sam")
    with pytest.raises(CaptureError, match='of type "sam"; expected one of dinov2') as caught:
        DinoFeatures.of(other)
    assert "\n" not in str(caught.value)
    (other / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(CaptureError, match="cannot be loaded"):
        SamGroups.of(other)
