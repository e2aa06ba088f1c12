"""Folders as Hugging Face publishes them, of small models with random weights."""

from __future__ import annotations

import json
import string
from pathlib import Path

BEGIN, END, PAD = "<|startoftext|>", "<|endoftext|>", "<pad>"
SIDE = 32
README = "---\nlicense: mit\n---\nRandom weights.\n"


def write_tokenizer(folder: Path, lowercase: bool, special: tuple[str, ...] = ()) -> int:
    """Characters, so that it knows every text; the number of tokens. The end is the highest."""
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers, processors

    letters = sorted({*string.printable} - {"?"})
    vocabulary = {
        token: i for i, token in enumerate([PAD, BEGIN, "?", *letters, "Yes", "No", *special, END])
    }
    tokenizer = Tokenizer(models.WordLevel(vocabulary, unk_token="?"))
    tokenizer.pre_tokenizer = pre_tokenizers.Split(Regex("."), "isolated")
    if lowercase:
        tokenizer.normalizer = normalizers.Lowercase()
    tokenizer.post_processor = processors.TemplateProcessing(
        single=f"{BEGIN} $A {END}",
        special_tokens=[(BEGIN, vocabulary[BEGIN]), (END, vocabulary[END])],
    )
    tokenizer.add_special_tokens(list(special))
    tokenizer.save(str(folder / "tokenizer.json"))
    (folder / "tokenizer_config.json").write_text(json.dumps({"pad_token": PAD}))
    return len(vocabulary)


def write_clip(folder: Path, seed: int = 0) -> Path:
    """CLIP, two layers of 64."""
    import torch
    from transformers import CLIPConfig, CLIPModel

    folder.mkdir(parents=True, exist_ok=True)
    tokens = write_tokenizer(folder, lowercase=True)
    tower = {
        "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
        "num_attention_heads": 4, "projection_dim": 48,
    }  # fmt: skip
    text = {
        **tower, "vocab_size": tokens, "max_position_embeddings": 77,
        "bos_token_id": 1, "eos_token_id": tokens - 1, "pad_token_id": 0,
    }  # fmt: skip
    vision = {**tower, "image_size": SIDE, "patch_size": 8}
    torch.manual_seed(seed)
    config = CLIPConfig(text_config=text, vision_config=vision, projection_dim=48)
    _alive(CLIPModel(config)).save_pretrained(folder)
    _write_preprocessor(folder, {"shortest_edge": SIDE}, crop={"height": SIDE, "width": SIDE})
    return folder


def write_siglip(folder: Path, seed: int = 0) -> Path:
    """SigLIP, two layers of 64, with a tokenizer that leaves lower case to others."""
    import torch
    from transformers import SiglipConfig, SiglipModel

    folder.mkdir(parents=True, exist_ok=True)
    tokens = write_tokenizer(folder, lowercase=False)
    size = {
        "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
        "num_attention_heads": 4,
    }  # fmt: skip
    text = {**size, "vocab_size": tokens, "max_position_embeddings": 64, "projection_size": 64}
    vision = {**size, "image_size": SIDE, "patch_size": 8}
    torch.manual_seed(seed)
    model = _alive(SiglipModel(SiglipConfig(text_config=text, vision_config=vision)))
    model.save_pretrained(folder)
    _write_preprocessor(folder, {"height": SIDE, "width": SIDE}, crop=None)
    return folder


def _write_preprocessor(folder: Path, size: dict, crop: dict | None) -> None:
    settings = {
        "do_resize": True, "size": size, "do_center_crop": crop is not None, "crop_size": crop,
        "do_rescale": True, "rescale_factor": 1 / 255, "do_normalize": True,
        "image_mean": [0.5, 0.4, 0.3], "image_std": [0.3, 0.4, 0.5],
    }  # fmt: skip
    (folder / "preprocessor_config.json").write_text(json.dumps(settings))
    (folder / "README.md").write_text(README)


def _alive(model):
    """Weights large enough that inputs matter, and biases and norms that are not 0 and 1."""
    import torch

    with torch.no_grad():
        for parameter in model.parameters():
            spread = 0.1 if parameter.ndim < 2 else parameter[0].numel() ** -0.5
            parameter.add_(torch.randn_like(parameter) * spread)
    return model.eval()


IMAGE = {
    "idefics3": "<image>", "smolvlm": "<image>",
    "qwen2_vl": "<|image_pad|>", "qwen3_vl": "<|image_pad|>",
}  # fmt: skip
"""Token of an image, by `model_type`."""
TEMPLATE = (
    "{%% for message in messages %%}{{ message['role'] }}: {%% for part in message['content'] %%}"
    "{%% if part['type'] == 'image' %%}%s{%% else %%}{{ part['text'] }}{%% endif %%}{%% endfor %%}"
    "\n{%% endfor %%}"
)
"""Chat template, in the style of the families."""


def write_vlm(folder: Path, kind: str, seed: int = 0) -> Path:
    """Write a vision-language model with two layers of width 64 in each half."""
    import torch
    import transformers

    folder.mkdir(parents=True, exist_ok=True)
    tokens = write_tokenizer(folder, lowercase=False, special=(IMAGE[kind],))
    vocabulary = json.loads((folder / "tokenizer.json").read_text())["model"]["vocab"]
    text = {
        "vocab_size": tokens, "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
        "num_attention_heads": 4, "num_key_value_heads": 2, "max_position_embeddings": 2048,
        "bos_token_id": 1, "eos_token_id": tokens - 1, "pad_token_id": 0,
    }  # fmt: skip
    ids = {"image_token_id": vocabulary[IMAGE[kind]]}
    torch.manual_seed(seed)
    if kind in ("qwen2_vl", "qwen3_vl"):
        rope = {"rope_type": "default", "rope_theta": 1e4, "mrope_section": [2, 3, 3]}
        vision = {
            "hidden_size": 64, "depth": 2, "num_heads": 4,
            "patch_size": 4, "spatial_merge_size": 2, "temporal_patch_size": 2,
        }  # fmt: skip
        if kind == "qwen2_vl":
            vision |= {"embed_dim": 64, "mlp_ratio": 2}
        else:
            text |= {"head_dim": 16}
            vision |= {
                "intermediate_size": 128, "out_hidden_size": 64, "num_position_embeddings": 25,
                "deepstack_visual_indexes": [0, 1],
            }  # fmt: skip
        ids |= {"vision_start_token_id": 1, "video_token_id": 2}
        prefix = {"qwen2_vl": "Qwen2VL", "qwen3_vl": "Qwen3VL"}[kind]
        config = getattr(transformers, f"{prefix}Config")(
            text_config={**text, "rope_parameters": rope}, vision_config=vision, **ids
        )
        model = getattr(transformers, f"{prefix}ForConditionalGeneration")(config)
        settings = {
            "image_processor_type": "Qwen2VLImageProcessor", "patch_size": 4, "merge_size": 2,
            "temporal_patch_size": 2, "min_pixels": 64, "max_pixels": 2560, "resample": 3,
        }  # fmt: skip
    else:
        vision = {
            "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
            "num_attention_heads": 4, "image_size": SIDE, "patch_size": 4,
        }  # fmt: skip
        name = {"idefics3": "Idefics3", "smolvlm": "SmolVLM"}[kind]
        config = getattr(transformers, f"{name}Config")(
            text_config={"model_type": "llama", **text}, vision_config=vision, scale_factor=2,
            tie_word_embeddings=False, **ids,
        )  # fmt: skip
        model = getattr(transformers, f"{name}ForConditionalGeneration")(config)
        settings = {
            "image_processor_type": "Idefics3ImageProcessor", "do_image_splitting": True,
            "size": {"longest_edge": 2 * SIDE}, "max_image_size": {"longest_edge": SIDE},
            "resample": 1,
        }  # fmt: skip
        (folder / "processor_config.json").write_text(json.dumps({"image_seq_len": 16}))
    _alive(model).save_pretrained(folder)
    settings |= {"image_mean": [0.5] * 3, "image_std": [0.5] * 3, "rescale_factor": 1 / 255}
    (folder / "preprocessor_config.json").write_text(json.dumps(settings))
    (folder / "chat_template.jinja").write_text(TEMPLATE % IMAGE[kind])
    (folder / "README.md").write_text(README)
    return folder


def write_owlv2(folder: Path, seed: int = 0, config: dict | None = None) -> Path:
    """Write OWLv2: two layers of 64 in each half and 6 x 6 patches, or as `config` says.

    Its class head finds something in a part of the patches, so that detections can be compared.
    """
    import torch
    from transformers import Owlv2Config, Owlv2ForObjectDetection

    folder.mkdir(parents=True, exist_ok=True)
    tokens = write_tokenizer(folder, lowercase=False)
    size = {
        "hidden_size": 64, "intermediate_size": 128, "num_hidden_layers": 2,
        "num_attention_heads": 4,
    }  # fmt: skip
    text = {**size, "vocab_size": tokens, "bos_token_id": 1, "eos_token_id": tokens - 1}
    text["max_position_embeddings"] = 32
    vision = {**size, "image_size": 48, "patch_size": 8}
    if config is None:
        config = {"text_config": text, "vision_config": vision, "projection_dim": 64}
    torch.manual_seed(seed)
    model = _alive(Owlv2ForObjectDetection(Owlv2Config(**config)))
    with torch.no_grad():
        model.class_head.logit_shift.weight.mul_(0.01)
        model.class_head.logit_shift.bias.fill_(-0.05)
        model.class_head.logit_scale.bias.fill_(9.0)
    model.save_pretrained(folder)
    side = model.config.vision_config.image_size
    _write_preprocessor(folder, {"height": side, "width": side}, crop=None)
    return folder


def write_segformer(folder: Path, labels: tuple[str, ...], seed: int = 0) -> Path:
    """Write SegFormer: four stages of one block, 8 to 32 channels, for 64 x 64 px."""
    import torch
    from transformers import SegformerConfig, SegformerForSemanticSegmentation

    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    config = SegformerConfig(
        depths=[1] * 4, hidden_sizes=[8, 16, 24, 32], num_attention_heads=[1, 2, 2, 4],
        decoder_hidden_size=32, id2label=dict(enumerate(labels)),
    )  # fmt: skip
    _alive(SegformerForSemanticSegmentation(config)).save_pretrained(folder)
    _write_preprocessor(folder, {"height": 64, "width": 64}, crop=None)
    return folder
