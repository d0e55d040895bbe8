"""Both forms of the kernels on the device under test."""

import dataclasses

from cmp_cl import Device
from cmp_cl.opencl.device import DeviceKind
from cmp_cl.stages.form import Form

KINDS = {Form.CPU: DeviceKind.CPU, Form.PORTABLE: DeviceKind.GPU}


def in_form(device: Device, form: Form) -> Device:
    """Return the device as if it were of the kind that has that form."""
    return dataclasses.replace(device, kind=KINDS[form])
