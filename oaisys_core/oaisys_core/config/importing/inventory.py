"""What becomes of each key of an original configuration file.

Keys are dotted paths without the indices of lists; ``*`` stands for any key. `Fate.kind` says
whether a key is ``mapped`` to ours, has ``no effect`` in the original either, or has ``no
counterpart`` here; `Fate.text` says where it went, or why not.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

Kind = Literal["mapped", "no effect", "no counterpart"]


@dataclass(frozen=True)
class Fate:
    """What becomes of a key."""

    kind: Kind
    text: str


def fate_of(path: str) -> Fate | None:
    """Return what becomes of a key; None: it is not known."""
    for patterns, fate in _FATES:
        if any(path == pattern or fnmatchcase(path, pattern) for pattern in patterns):
            return fate
    return None


def _mapped(text: str, *paths: str) -> tuple[tuple[str, ...], Fate]:
    return paths, Fate("mapped", text)


def _no_effect(text: str, *paths: str) -> tuple[tuple[str, ...], Fate]:
    return paths, Fate("no effect", text)


def _none(text: str, *paths: str) -> tuple[tuple[str, ...], Fate]:
    return paths, Fate("no counterpart", text)


def _within(prefix: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{prefix}.{name}" for name in names)


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
MATERIAL = "ASSET_SETUP.MATERIALS"
GENERAL = f"{MATERIAL}.materialParams.general"
LAYER = f"{MATERIAL}.materialParams.terrainTextureList"
STAGE = "ASSET_SETUP.STAGES"
GROUND = f"{STAGE}.stageParams"
ANT = f"{GROUND}.landscapeParams"
MESH = "ASSET_SETUP.MESHES"
THING = f"{MESH}.meshParams"
DENSITY = f"{THING}.densityMapSettings.densityMap"
DISPLACED = f"{THING}.assetDisplacementParams"
FLIGHT = f"{THING}.trajectoryParams"

_FATES: tuple[tuple[tuple[str, ...], Fate], ...] = (
    _mapped("output.folder", f"{RUN}.outputPath"),
    _mapped("output.batches", f"{RUN}.numBatches"),
    _mapped("output.samples", f"{RUN}.numSamplesPerBatch"),
    _mapped("output.save_blend", f"{RUN}.saveBlenderFiles"),
    _mapped("output.batch_offset", f"{RUN}.outputIDOffset"),
    _none("images are what `oaisys render` is for", f"{RUN}.renderImages"),
    _none("poses, provenance and labels are always written", f"{RUN}.saveMetaData"),
    _no_effect("nothing reads it", *_within(RUN, "defaultCfg", "saveConfigFiles")),
    _none("colour is always rendered by Cycles", f"{RENDER}.renderEngine"),
    _mapped("render.device: auto, a GPU where there is one, or cpu", f"{RENDER}.renderDevice"),
    _none("it switches adaptive subdivision on; see stage.detail", f"{RENDER}.renderFeatureSet"),
    _no_effect("the lines that read it are commented out", f"{RENDER}.performanceTiles?"),
    _mapped("the modalities of all cameras", f"{IMAGES}.type"),
    _mapped(
        "samples: render.samples (of RGBDPass; labels are exact without)",
        f"{IMAGES}.passParams.renderSamples",
    ),
    _mapped("render.max_bounces", f"{IMAGES}.passParams.lightPathesMaxBounces"),
    _mapped(
        "the number of semantic levels (of SemanticPass; other passes repeat nothing)",
        f"{IMAGES}.passParams.numIter",
    ),
    _no_effect("DepthEnabled of a sensor decides", f"{IMAGES}.passParams.renderDepthActive"),
    _none("files have the kinds that hold them without loss", f"{IMAGES}.passParams.imageFileType"),
    _no_effect("there is one image that effects work on", f"{POST}.GENERAL.renderPasses"),
    _mapped("render.effects.bloom", f"{POST}.POST_EFFECTS.type"),
    _mapped("render.effects.bloom.threshold", f"{POST}.POST_EFFECTS.effectParams.threshold"),
    _mapped("render.effects.bloom.radius_px", f"{POST}.POST_EFFECTS.effectParams.size"),
    _mapped("render.effects.bloom.strength", f"{POST}.POST_EFFECTS.effectParams.mix"),
    _none("bloom has one quality", f"{POST}.POST_EFFECTS.effectParams.quality"),
    _none(
        "images are not combined with each other",
        *_within(
            f"{POST}.POST_EFFECTS.effectParams",
            *("combineOption", "combineFac", "combineInput?", "outputName"),
        ),
    ),
    _mapped("sensors.motion.kind", f"{RIG}.sensorMovementType"),
    _mapped("sensors.motion.path, its poses turned to ours", f"{RIG}.sensorMovementPose"),
    _mapped("sensors.motion.offset_m", f"{RIG}.deterministicSensorOffsetPos"),
    _mapped("sensors.motion.step_interval", f"{RIG}.stepInterval"),
    _mapped(
        "sensors.motion.height_above_ground_m",
        *_within(RIG, "hoverBaseModeEnabled", "hoverBaseDistance"),
    ),
    _mapped(
        "sensors.motion.height_above_ground_m: that it is there lets heights vary between half "
        "and all of hoverBaseDistance where targets hover; its value has no effect there either",
        f"{RIG}.hoverBaseDistanceNoise",
    ),
    _mapped(
        "sensors.motion.target_above_ground_m",
        *_within(RIG, "hoverTargetModeEnabled", "hoverTargetDistance"),
    ),
    _none("there is one stage", *_within(RIG, "hoverBaseStage", "hoverTargetStage")),
    _mapped("sensors.motion.position_m", f"{RIG}.randomEuclideanPosM??"),
    _mapped("sensors.motion.target_m, counted from the rig", f"{RIG}.randomTargetPosM??"),
    _mapped("sensors.motion.roll_deg", f"{RIG}.randomTargetRollDeg"),
    _none(
        "its quaternions are stored in the wrong order there, so that these are not the angles "
        "about any axes; at 0 the rig looks down, and so it does here",
        f"{RIG}.randomEuclideanEulerM??",
    ),
    _no_effect("a target has no direction", f"{RIG}.randomTargetEulerM??"),
    _no_effect("only the mode `none` is implemented", f"{RIG}.interpolationMode"),
    _mapped("sensors.motion.target_m: where that object stands", f"{RIG}.targetObject"),
    _mapped(
        "sensors.motion.distance_m, in units of the object's radius", f"{RIG}.sensorDistanceScale"
    ),
    _mapped(
        "sensors.motion.approach", *_within(RIG, "landingMode", "finalApproachDistance")
    ),
    _none("nothing rides on the rig", f"{RIG}.MESH_FOLLOWER.*"),
    _none("it is switched on by other keys", f"{RIG}.randomTargetRollRad"),
    _no_effect(
        "nothing reads it",
        *_within(RIG, "baseMovement.*", "positionOffsetEnabled", "targetObjectActive"),
        *_within(RIG, "tragetObjectMovementType", "MESH_FOLLOWERb.*"),
    ),
    _mapped("sensors.cameras (SensorCameraRGBD)", f"{SENSOR}.type"),
    _mapped("sensors.cameras.name", f"{CAMERA}.outputBaseName"),
    _mapped("sensors.cameras.width_px, height_px", f"{CAMERA}.imageResolution"),
    _mapped("sensors.cameras.fx_px, fy_px, cx_px, cy_px", f"{CAMERA}.KMatrix"),
    _mapped(
        "sensors.cameras.mount_position_m, mount_quat_xyzw, from Blender's axes to a link's",
        f"{CAMERA}.transformation",
    ),
    _mapped("sensors.cameras.modalities", f"{CAMERA}.renderPasses.*.activationSlot"),
    _mapped("sensors.cameras.modalities (depth)", f"{CAMERA}.renderPasses.*.DepthEnabled"),
    _mapped("sensors.cameras.lens.focus_distance_m", f"{CAMERA}.depthOfField.distance"),
    _mapped("sensors.cameras.lens.f_number", f"{CAMERA}.depthOfField.fStop"),
    _mapped("sensors.cameras.lens.blades", f"{CAMERA}.depthOfField.blades"),
    _mapped("sensors.cameras.lens.blade_rotation_deg", f"{CAMERA}.depthOfField.rotationDeg"),
    _mapped("sensors.cameras.lens.ratio", f"{CAMERA}.depthOfField.ratio"),
    _no_effect(
        "nothing reads it; KMatrix decides",
        *_within(CAMERA, "cameraFocalLength", "cameraFOVHorizontal", "cameraFOVVertical"),
        *_within(CAMERA, "cameraSensorWidth", "cameraPrinciplePoint?", "stereoBaseLine"),
    ),
    _no_effect("sensors never ask for it", f"{CAMERA}.triggerInterval"),
    _mapped("environment.sky_strength and sun_strength_w_m2", f"{ENV}.GENERAL.backgroundStrength"),
    _mapped("environment.redraw: sample, step_interval", f"{ENV}.GENERAL.stepInterval"),
    _mapped("environment.sky or environment.hdri", f"{EFFECT}.type"),
    _no_effect("nothing reads it there", f"{EFFECT}.stepInterval"),
    _mapped(
        "environment.step_interval, where it is LOCAL",
        *_within(SKY, "stepIntervalOption", "stepInterval"),
    ),
    _mapped("environment.sun_angular_diameter_deg", f"{SKY}.SunSize"),
    _mapped("environment.sun_strength_w_m2", f"{SKY}.SunIntensity"),
    _mapped("environment.sun_elevation_deg", f"{SKY}.SunElevation"),
    _mapped(
        "environment.sun_azimuth_deg, from clockwise off +y to counter-clockwise off +x",
        f"{SKY}.SunRotation",
    ),
    _mapped("environment.altitude_m", f"{SKY}.SunAltitude"),
    _mapped("environment.air", f"{SKY}.AirDensity"),
    _mapped("environment.dust", f"{SKY}.DustDensity"),
    _mapped("environment.ozone", f"{SKY}.OzoneDensity"),
    _no_effect("nothing reads it", f"{SKY}.SunStrength"),
    _mapped(
        "environment.sky_semantic_id, sky_levels", f"{SKY}.passParams.SemanticPass.semanticIDVec"
    ),
    _no_effect(
        "nothing reads it; the sky is no instance",
        *_within(f"{SKY}.passParams", "RGBDPass.rgbIDVec", "InstancePass.instanceIDVec"),
    ),
    _mapped("environment.hdri.choose", f"{SKY}.selectionOption"),
    _mapped("environment.hdri.images.file", f"{SKY}.HDRIList.filePath"),
    _no_effect("nothing reads it; backgroundStrength decides", f"{SKY}.HDRIList.strength"),
    _mapped(
        "environment.hdri.images.semantic_id, levels, labels_from", f"{SKY}.HDRIList.labelIDVec*"
    ),
    _mapped("what stages and objects call it by", f"{MATERIAL}.name"),
    _mapped("materials.pools (MaterialTerrain, MaterialAsteroid)", f"{MATERIAL}.type"),
    _mapped("materials.pools.count", *_within(GENERAL, "minNumMixTerrains", "maxNumMixTerrains")),
    _mapped("materials.label_borders", f"{GENERAL}.hardLabelBorders"),
    _mapped("materials.pools.replacement", f"{GENERAL}.withReplacement"),
    _mapped("a factor on materials.pools.layers.displacement_m", f"{GENERAL}.dispScale"),
    _mapped("a factor on materials.pools.layers.normal_strength", f"{GENERAL}.normalStrength"),
    _none("relief leaves the mean height as it is", f"{GENERAL}.dispMidLevel"),
    _mapped("materials.mask.noise.scale", f"{GENERAL}.mergingNoise.Scale"),
    _mapped("materials.mask.noise.detail", f"{GENERAL}.mergingNoise.Detail"),
    _mapped("materials.mask.noise.roughness", f"{GENERAL}.mergingNoise.Roughness"),
    _mapped("materials.mask.noise.distortion", f"{GENERAL}.mergingNoise.Distortion"),
    _mapped(
        "materials.pools.layers.folder",
        *_within(GENERAL, "baseTexturePath", "baseTexturePathOverwriteEnabled"),
        *_within(f"{LAYER}*", "noPathOverwrite", "basePath"),
    ),
    _no_effect(
        "nothing reads it",
        *_within(GENERAL, "texture_base_path", "known_list_id", "known_list_id_bak"),
        *_within(GENERAL, "number_*known_limits", "number_*known_limits_bak"),
    ),
    _mapped(
        "materials.pools.layers.folder; keys of the template are read as if they stood here",
        f"{LAYER}*.templatePath",
    ),
    _mapped("materials.pools.layers.folder", f"{LAYER}*.path"),
    _mapped("materials.pools.layers.tile_m: the stage's size over it", f"{LAYER}*.size"),
    _mapped(
        "materials.pools.layers.displacement_m",
        *_within(f"{LAYER}*", "dispStrength", "dispColorStopColor_?", "dispmapStrength"),
    ),
    _none(
        "height maps are used as they are, without a ramp's stops",
        f"{LAYER}*.dispColorStopPosition_?",
    ),
    _mapped("materials.pools.layers.normal_strength", f"{LAYER}*.normalStrength"),
    _mapped("materials.pools.layers.anti_tiling", f"{LAYER}*.tilingMode"),
    _mapped(
        "materials.pools.layers.anti_tiling, rotation_deg: half of it to either side",
        f"{LAYER}*.mosaicRotation",
    ),
    _none("cells of anti-tiling have borders of one kind", f"{LAYER}*.mosaicNoise"),
    _none(
        "tiles are square, and cells of anti-tiling as large as a tile",
        *_within(f"{LAYER}*", "imageTile?", "scaleFileFac", "scaleYXRatio"),
    ),
    _none(
        "the maps that a folder has are used",
        *_within(f"{LAYER}*", "diffuse", "ref", "spec", "normal", "displacement", "emission"),
    ),
    _mapped(
        "materials.pools.layers.color.curves",
        f"{LAYER}*.colorAdjustment.?ColorPoints",
    ),
    _mapped("materials.pools.layers.color.hue_deg", f"{LAYER}*.colorVariation.hue"),
    _mapped("materials.pools.layers.color.saturation", f"{LAYER}*.colorVariation.saturation"),
    _mapped("materials.pools.layers.color.value", f"{LAYER}*.colorVariation.brithness"),
    _none(
        "colour varies from batch to batch, and by materials.variation from place to place",
        f"{LAYER}*.colorVariation.merging*",
    ),
    _mapped(
        "materials.pools.layers.semantic_id, levels, labels_from",
        f"{LAYER}*.passParams.semantic_label.labelIDVec*",
    ),
    _none("colours and instances need no parameters", f"{LAYER}*.passParams.*"),
    _none("there is one stage", f"{STAGE}.name"),
    _mapped("stage.preset or stage.mesh", f"{STAGE}.type"),
    _mapped("stage.extent_m", f"{GROUND}.stageSizeX"),
    _mapped("stage.preset", f"{GROUND}.stageLandscapePreset"),
    _mapped("materials", f"{GROUND}.assetMaterial"),
    _no_effect("a name within Blender", f"{GROUND}.stageName"),
    _none("each batch draws its own ground from the seed", f"{ANT}.random_seed"),
    _no_effect(
        "a switch of the add-on's user interface, or of what it does beside the terrain",
        *_within(ANT, "show_*", "refresh", "auto_refresh", "texture_block", "at_cursor"),
        *_within(ANT, "land_material", "water_*", "vert_group", "smooth_mesh", "tri_face"),
        *_within(ANT, "sphere_mesh", "remove_double", "mesh_size", "ant_terrain_name"),
    ),
    _none("a parameter of the add-on's noise; stage.preset has its own shape", f"{ANT}.*"),
    _mapped("stage.mesh.file", f"{GROUND}.stageFilePath"),
    _mapped("stage.mesh.object", f"{GROUND}.meshInstanceName"),
    _mapped(
        "stage.preset: a ground of noise instead of the mesh, which is not displaced",
        f"{GROUND}.stageDisplacementActive",
    ),
    _mapped("stage.relief_m", f"{GROUND}.stageDisplacementStrength"),
    _none("the median height comes to z = 0", f"{GROUND}.stageDisplacementMidLevel"),
    _none("there is one kind of such noise", f"{GROUND}.stageDisplacementNoise*"),
    _none("see stage.detail", *_within(GROUND, "stagedDicing*", "NOSUBSURF")),
    _none("a mesh's own materials and particles are left out", f"{GROUND}.noCleaning"),
    _none("a mesh's own materials and particles are left out", f"{GROUND}.particleSystems.*"),
    _mapped("assets.groups.name or assets.objects.name", f"{MESH}.name"),
    _mapped("assets.groups (MeshMultipleRandom) or objects (MeshAsteroid)", f"{MESH}.type"),
    _mapped("assets.*.file", f"{THING}.meshFilePath"),
    _mapped("assets.*.object_name", f"{THING}.meshInstanceName"),
    _mapped(
        "assets.groups.count", *_within(THING, "numberInstances"),
        f"{THING}.densityMapSettings.numberInstances",
    ),
    _mapped(
        "assets.groups.probability; objects are always there",
        *_within(THING, "randomSwitchOnOff"),
    ),
    _none("objects are always there", f"{THING}.activationProbability"),
    _no_effect(
        "the key outside densityMapSettings decides",
        f"{THING}.densityMapSettings.randomSwitchOnOff",
    ),
    _none("everything has an instance id", f"{THING}.instanceLabelActive"),
    _none("ids of instances reach as far as needed", f"{THING}.numInstanceLabelPerChannel"),
    _mapped("assets.groups.density", f"{THING}.useDensityMap"),
    _mapped("assets.groups.density.kind", f"{DENSITY}.noiseType"),
    _mapped(
        "assets.groups.density: its cells' or patches' size", *_within(DENSITY, "size", "scale")
    ),
    _mapped(
        "assets.groups.density.cover, roughly",
        *_within(DENSITY, "intensity", "colorStopPosition_?", "colorStopColor_?"),
    ),
    _none("there are no gradients across a stage", f"{DENSITY}.progression"),
    _no_effect("nothing reads it", f"{THING}.refreshFreq"),
    _mapped("assets.groups.size_m", *_within(THING, "defaultSize", "strengthRandomScale")),
    _mapped("assets.groups.yaw_deg, tilt_deg", f"{THING}.randomRotationEnabled"),
    _mapped("assets.groups.align", f"{THING}.rotationOptionMode"),
    _mapped("assets.groups.tilt_deg", f"{THING}.rotationOptionFactor"),
    _mapped("assets.groups.yaw_deg", f"{THING}.rotationOptionPhase*"),
    _none("things are scattered over the stage", *_within(THING, "meshEmitter", "emitterFilePath")),
    _none("there is one stage", f"{THING}.appliedOnStage"),
    _none("turn the mesh in its file", f"{THING}.preRotationDeg"),
    _mapped("assets.*.semantic_id, levels", f"{THING}.passParams.semantic_label.labelIDVec*"),
    _none("colours and instances need no parameters", f"{THING}.passParams.*"),
    _mapped("assets.objects.texture, semantic_id, levels", f"{THING}.assetMaterial"),
    _mapped("assets.objects.position_m", *_within(THING, "location", "trajectorySimulation")),
    _mapped("assets.objects.quat_xyzw", *_within(THING, "rotation_deg", "rotation_rad")),
    _none("an object's attitude is given", f"{THING}.random_rotation"),
    _none("raises an error there", f"{THING}.scale"),
    _none("output.samples is one for all", f"{THING}.numSamples"),
    _none(
        "an object stays where it is, the rig moves; assets.movers can follow a CSV file",
        f"{FLIGHT}.*", f"{THING}.assetDistanceScale",
    ),
    _none("shapes from files are not displaced", f"{DISPLACED}.*"),
    _none("there is one kind of object", f"{THING}.NOSUBSURF"),
    _no_effect("nothing reads it", "ASSET_SETUP.GENERAL.*"),
)  # fmt: skip
