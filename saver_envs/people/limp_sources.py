"""Publications from which the limp person's numbers are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

#: Key -> source.
SOURCES: Final[Mapping[str, str]] = {
    "leva": "P. de Leva, Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters, J. "
    "Biomechanics 29 (1996) 1223-1230",
    "iso": "ISO/TS 15066:2016, Robots and robotic devices: collaborative robots, table A.2",
    "boone": "D. C. Boone, S. P. Azen, Normal range of motion of joints in male subjects, J. Bone "
    "and Joint Surgery (American) 61 (1979) 756-759",
    "white": "A. A. White, M. M. Panjabi, Clinical Biomechanics of the Spine, 2nd ed. (1990)",
    "youdas": "J. W. Youdas et al., Normal range of motion of the cervical spine: an initial "
    "goniometric study, Physical Therapy 72 (1992) 770-780",
    "riener": "R. Riener, T. Edrich, Identification of passive elastic joint moments in the lower "
    "extremities, J. Biomechanics 32 (1999) 539-544",
    "wiegner": "A. W. Wiegner, R. L. Watts, Elastic properties of muscles measured at the elbow in "
    "man: I. Normal controls, J. Neurology, Neurosurgery and Psychiatry 49 (1986) 1171-1176",
    "watt": "A. A. Watt, A. J. Callaway, J. M. Williams, In vivo through-range passive stiffness "
    "of the lumbar spine: a meta-analysis of measurements and methods, Medical & Biological "
    "Engineering & Computing 60 (2022) 2133-2157",
    "mcgill": "S. M. McGill, K. Jones, G. Bennett, P. J. Bishop, Passive stiffness of the human "
    "neck in flexion, extension, and lateral bending, Clinical Biomechanics 9 (1994) 193-198",
    "temel": "M. Temel, A. A. Johnson, A. B. Lloyd, Evaluating the repeatability of friction "
    "coefficient measurements and tactile perceptions in skin-textile interactions across body "
    "regions, Tribology Letters 70 (2022)",
}
#: Key of a number that is chosen here.
OURS: Final = "ours"
