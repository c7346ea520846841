"""What becomes of the original keys of the run, the images, the sensors and the environment."""

from __future__ import annotations

from oaisys_core.config.importing.key_outcomes import (
    KeyRule,
    mapped,
    no_counterpart,
    no_effect,
    within,
)

RUN = "SIMULATION_SETUP"
RENDER = "RENDER_SETUP.GENERAL"
IMAGES = "RENDER_SETUP.RENDER_PASSES"
POST = "RENDER_POST_PROCESSING_EFFECTS_SETUP"
RIG = "SENSOR_SETUP.GENERAL"
SENSOR = "SENSOR_SETUP.SENSORS"
CAMERA = f"{SENSOR}.sensorParams"
ENV = "ENVIRONMENT_EFFECTS_SETUP"
EFFECT = f"{ENV}.ENVIRONMENT_EFFECTS"
SKY = f"{EFFECT}.environmentEffectsParams"

SIMULATION_RULES: tuple[KeyRule, ...] = (
    mapped("output.folder", f"{RUN}.outputPath"),
    mapped("output.batches", f"{RUN}.numBatches"),
    mapped("output.samples", f"{RUN}.numSamplesPerBatch"),
    mapped("output.save_blend", f"{RUN}.saveBlenderFiles"),
    mapped("output.batch_offset", f"{RUN}.outputIDOffset"),
    no_counterpart("`oaisys render` always writes images", f"{RUN}.renderImages"),
    no_counterpart("poses, provenance and labels are always written", f"{RUN}.saveMetaData"),
    no_effect("nothing reads it", *within(RUN, "defaultCfg", "saveConfigFiles")),
    no_counterpart("colour is always rendered by Cycles", f"{RENDER}.renderEngine"),
    mapped("render.device: auto, a GPU where there is one, or cpu", f"{RENDER}.renderDevice"),
    no_counterpart(
        "it enables adaptive subdivision; see stage.detail instead", f"{RENDER}.renderFeatureSet"
    ),
    no_effect("the lines that read it are commented out", f"{RENDER}.performanceTiles?"),
    mapped("the modalities of all cameras", f"{IMAGES}.type"),
    mapped(
        "samples: render.samples (of RGBDPass; labels are exact without)",
        f"{IMAGES}.passParams.renderSamples",
    ),
    mapped("render.max_bounces", f"{IMAGES}.passParams.lightPathesMaxBounces"),
    mapped(
        "the number of semantic levels (of SemanticPass; other passes repeat nothing)",
        f"{IMAGES}.passParams.numIter",
    ),
    no_effect("DepthEnabled of a sensor decides", f"{IMAGES}.passParams.renderDepthActive"),
    no_counterpart(
        "the file type is chosen so that nothing is lost", f"{IMAGES}.passParams.imageFileType"
    ),
    no_effect("effects apply to one image only", f"{POST}.GENERAL.renderPasses"),
    mapped("render.effects.bloom", f"{POST}.POST_EFFECTS.type"),
    mapped("render.effects.bloom.threshold", f"{POST}.POST_EFFECTS.effectParams.threshold"),
    mapped("render.effects.bloom.radius_px", f"{POST}.POST_EFFECTS.effectParams.size"),
    mapped("render.effects.bloom.strength", f"{POST}.POST_EFFECTS.effectParams.mix"),
    no_counterpart("bloom has one quality", f"{POST}.POST_EFFECTS.effectParams.quality"),
    no_counterpart(
        "images are not combined with each other",
        *within(
            f"{POST}.POST_EFFECTS.effectParams",
            *("combineOption", "combineFac", "combineInput?", "outputName"),
        ),
    ),
    mapped("sensors.motion.kind", f"{RIG}.sensorMovementType"),
    mapped("sensors.motion.path, with poses in our convention", f"{RIG}.sensorMovementPose"),
    mapped("sensors.motion.offset_m", f"{RIG}.deterministicSensorOffsetPos"),
    mapped("sensors.motion.step_interval", f"{RIG}.stepInterval"),
    mapped(
        "sensors.motion.height_above_ground_m",
        *within(RIG, "hoverBaseModeEnabled", "hoverBaseDistance"),
    ),
    mapped(
        "sensors.motion.height_above_ground_m: if present, heights vary between half and all of "
        "hoverBaseDistance where targets hover; its value has no effect in the original either",
        f"{RIG}.hoverBaseDistanceNoise",
    ),
    mapped(
        "sensors.motion.target_above_ground_m",
        *within(RIG, "hoverTargetModeEnabled", "hoverTargetDistance"),
    ),
    no_counterpart("there is one stage", *within(RIG, "hoverBaseStage", "hoverTargetStage")),
    mapped("sensors.motion.position_m", f"{RIG}.randomEuclideanPosM??"),
    mapped("sensors.motion.target_m, relative to the rig", f"{RIG}.randomTargetPosM??"),
    mapped("sensors.motion.roll_deg", f"{RIG}.randomTargetRollDeg"),
    no_counterpart(
        "the original stores its quaternions in the wrong order, so these are not angles about any "
        "axes; at 0 the rig looks down, as it does here",
        f"{RIG}.randomEuclideanEulerM??",
    ),
    no_effect("a target has no direction", f"{RIG}.randomTargetEulerM??"),
    no_effect("only the mode `none` is implemented", f"{RIG}.interpolationMode"),
    mapped("sensors.motion.target_m: the position of that object", f"{RIG}.targetObject"),
    mapped(
        "sensors.motion.distance_m, in units of the object's radius", f"{RIG}.sensorDistanceScale"
    ),
    mapped("sensors.motion.approach", *within(RIG, "landingMode", "finalApproachDistance")),
    no_counterpart("no meshes move with the rig", f"{RIG}.MESH_FOLLOWER.*"),
    no_counterpart("other keys enable it", f"{RIG}.randomTargetRollRad"),
    no_effect(
        "nothing reads it",
        *within(RIG, "baseMovement.*", "positionOffsetEnabled", "targetObjectActive"),
        *within(RIG, "tragetObjectMovementType", "MESH_FOLLOWERb.*"),
    ),
    mapped("sensors.cameras (SensorCameraRGBD)", f"{SENSOR}.type"),
    mapped("sensors.cameras.name", f"{CAMERA}.outputBaseName"),
    mapped("sensors.cameras.width_px, height_px", f"{CAMERA}.imageResolution"),
    mapped("sensors.cameras.fx_px, fy_px, cx_px, cy_px", f"{CAMERA}.KMatrix"),
    mapped(
        "sensors.cameras.mount_position_m, mount_quat_xyzw, from Blender's axes to a link's",
        f"{CAMERA}.transformation",
    ),
    mapped("sensors.cameras.modalities", f"{CAMERA}.renderPasses.*.activationSlot"),
    mapped("sensors.cameras.modalities (depth)", f"{CAMERA}.renderPasses.*.DepthEnabled"),
    mapped("sensors.cameras.lens.focus_distance_m", f"{CAMERA}.depthOfField.distance"),
    mapped("sensors.cameras.lens.f_number", f"{CAMERA}.depthOfField.fStop"),
    mapped("sensors.cameras.lens.blades", f"{CAMERA}.depthOfField.blades"),
    mapped("sensors.cameras.lens.blade_rotation_deg", f"{CAMERA}.depthOfField.rotationDeg"),
    mapped("sensors.cameras.lens.ratio", f"{CAMERA}.depthOfField.ratio"),
    no_effect(
        "nothing reads it; KMatrix decides",
        *within(CAMERA, "cameraFocalLength", "cameraFOVHorizontal", "cameraFOVVertical"),
        *within(CAMERA, "cameraSensorWidth", "cameraPrinciplePoint?", "stereoBaseLine"),
    ),
    no_effect("sensors never use it", f"{CAMERA}.triggerInterval"),
    mapped("environment.sky_strength and sun_strength_w_m2", f"{ENV}.GENERAL.backgroundStrength"),
    mapped("environment.redraw: sample, step_interval", f"{ENV}.GENERAL.stepInterval"),
    mapped("environment.sky or environment.hdri", f"{EFFECT}.type"),
    no_effect("nothing reads it in this place", f"{EFFECT}.stepInterval"),
    mapped(
        "environment.step_interval, if it is LOCAL",
        *within(SKY, "stepIntervalOption", "stepInterval"),
    ),
    mapped("environment.sun_angular_diameter_deg", f"{SKY}.SunSize"),
    mapped("environment.sun_strength_w_m2", f"{SKY}.SunIntensity"),
    mapped("environment.sun_elevation_deg", f"{SKY}.SunElevation"),
    mapped(
        "environment.sun_azimuth_deg, from clockwise off +y to counter-clockwise off +x",
        f"{SKY}.SunRotation",
    ),
    mapped("environment.altitude_m", f"{SKY}.SunAltitude"),
    mapped("environment.air", f"{SKY}.AirDensity"),
    mapped("environment.dust", f"{SKY}.DustDensity"),
    mapped("environment.ozone", f"{SKY}.OzoneDensity"),
    no_effect("nothing reads it", f"{SKY}.SunStrength"),
    mapped(
        "environment.sky_semantic_id, sky_levels", f"{SKY}.passParams.SemanticPass.semanticIDVec"
    ),
    no_effect(
        "nothing reads it; the sky is not an instance",
        *within(f"{SKY}.passParams", "RGBDPass.rgbIDVec", "InstancePass.instanceIDVec"),
    ),
    mapped("environment.hdri.choose", f"{SKY}.selectionOption"),
    mapped("environment.hdri.images.file", f"{SKY}.HDRIList.filePath"),
    no_effect("nothing reads it; backgroundStrength decides", f"{SKY}.HDRIList.strength"),
    mapped(
        "environment.hdri.images.semantic_id, levels, labels_from", f"{SKY}.HDRIList.labelIDVec*"
    ),
)
