"""Colours of photographs with an embedded ICC profile, such as Display P3 or Adobe RGB, converted to sRGB."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image, ImageCms

_ALIKE = 1  # of 255: a profile that changes no colour by more is sRGB, as others write it
_LATTICE = np.arange(0, 256, 15).astype(np.uint8)  # levels of each channel that are tried for it
_SPACES = {"RGB": "RGB ", "RGBA": "RGB ", "CMYK": "CMYK"}  # of ICC, by mode of Pillow
_GREY = "grey levels"
_NAMES = {"GRAY": _GREY}  # of spaces, where not their own


class UnusableProfile(ValueError):
    """A profile that is damaged or of other colours than the photograph's."""


def in_srgb(image: Image.Image, *, in_place: bool = False) -> tuple[Image.Image, str | None]:
    """A PIL image of mode RGB, RGBA or CMYK with the colours that its profile tells, in sRGB, where others are clipped;
    and why its profile cannot be used, in which case, as without one, the image stays as it is.

    So it does where the profile is that of sRGB. With `in_place` the image may be overwritten.
    """
    if (profile := _profile(image)) is None:
        return image, None
    try:
        transform = _to_srgb(profile, image.mode)
    except UnusableProfile as error:
        return image, str(error)
    if transform is None:
        return image, None
    converted = ImageCms.applyTransform(image, transform, inPlace=in_place and image.mode != "CMYK")
    return converted or image, None


def grey_problem(image: Image.Image) -> str | None:
    """Why the profile of a PIL image of grey levels cannot be used, if so. They are taken as those of sRGB, whatever a
    profile of grey levels tells; many a tool leaves the sRGB profile in photographs that it makes grey."""
    if (profile := _profile(image)) is None:
        return None
    try:
        source, space = _read(profile)
        if space == "GRAY" or (space == _SPACES["RGB"] and _transform(source, "RGB") is None):
            return None
    except UnusableProfile as error:
        return str(error)
    return _of_others(space, _GREY)


def _profile(image: Image.Image) -> bytes | None:
    profile = image.info.get("icc_profile")
    return profile if isinstance(profile, bytes) and profile else None


def _to_srgb(profile: bytes, mode: str) -> ImageCms.ImageCmsTransform | None:
    """The relative colorimetric conversion from `profile`; None for that of sRGB. Raises `UnusableProfile`."""
    source, space = _read(profile)
    if space != _SPACES[mode]:
        raise UnusableProfile(_of_others(space, _SPACES[mode].strip()))
    return _transform(source, mode)


def _of_others(space: str, own: str) -> str:
    return f"it is one of {_NAMES.get(space, space.strip())}, the photograph has {own}"


def _read(profile: bytes) -> tuple[ImageCms.ImageCmsProfile, str]:
    """A profile and its colour space. Raises `UnusableProfile`."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        return source, source.profile.xcolor_space
    except (ImageCms.PyCMSError, OSError, ValueError) as error:  # the last for letters that are not ASCII
        raise _unreadable(error) from error


def _transform(source: ImageCms.ImageCmsProfile, mode: str) -> ImageCms.ImageCmsTransform | None:
    """The conversion of images of a mode, made in 2 ms, of CMYK in 20 to 35 ms; None for that of sRGB. Raises
    `UnusableProfile`."""
    target, intent = "RGB" if mode == "CMYK" else mode, ImageCms.Intent.RELATIVE_COLORIMETRIC
    try:
        transform = ImageCms.buildTransform(source, ImageCms.createProfile("sRGB"), mode, target, intent)
        return None if target == mode and _keeps_colours(transform, mode) else transform
    except (ImageCms.PyCMSError, OSError, ValueError) as error:
        raise _unreadable(error) from error


def _unreadable(error: Exception) -> UnusableProfile:
    return UnusableProfile(f"it cannot be read: {error}")


def _keeps_colours(transform: ImageCms.ImageCmsTransform, mode: str) -> bool:
    """Whether colours all over the cube stay within _ALIKE."""
    lattice = np.stack(np.meshgrid(_LATTICE, _LATTICE, _LATTICE), axis=-1).reshape(len(_LATTICE), -1, 3)
    converted = ImageCms.applyTransform(Image.fromarray(lattice).convert(mode), transform)
    assert converted is not None  # it is not in place
    change = np.asarray(converted)[:, :, :3].astype(np.int16) - lattice
    return bool(np.abs(change).max() <= _ALIKE)
