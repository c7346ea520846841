"""What becomes of the original keys of materials, stages and meshes."""

from __future__ import annotations

from oaisys_core.config.importing.key_outcomes import (
    KeyRule,
    mapped,
    no_counterpart,
    no_effect,
    within,
)

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

ASSET_RULES: tuple[KeyRule, ...] = (
    mapped("what stages and objects call it by", f"{MATERIAL}.name"),
    mapped("materials.pools (MaterialTerrain, MaterialAsteroid)", f"{MATERIAL}.type"),
    mapped("materials.pools.count", *within(GENERAL, "minNumMixTerrains", "maxNumMixTerrains")),
    mapped("materials.label_borders", f"{GENERAL}.hardLabelBorders"),
    mapped("materials.pools.replacement", f"{GENERAL}.withReplacement"),
    mapped("a factor on materials.pools.layers.displacement_m", f"{GENERAL}.dispScale"),
    mapped("a factor on materials.pools.layers.normal_strength", f"{GENERAL}.normalStrength"),
    no_counterpart("relief leaves the mean height as it is", f"{GENERAL}.dispMidLevel"),
    mapped("materials.mask.noise.scale", f"{GENERAL}.mergingNoise.Scale"),
    mapped("materials.mask.noise.detail", f"{GENERAL}.mergingNoise.Detail"),
    mapped("materials.mask.noise.roughness", f"{GENERAL}.mergingNoise.Roughness"),
    mapped("materials.mask.noise.distortion", f"{GENERAL}.mergingNoise.Distortion"),
    mapped(
        "materials.pools.layers.folder",
        *within(GENERAL, "baseTexturePath", "baseTexturePathOverwriteEnabled"),
        *within(f"{LAYER}*", "noPathOverwrite", "basePath"),
    ),
    no_effect(
        "nothing reads it",
        *within(GENERAL, "texture_base_path", "known_list_id", "known_list_id_bak"),
        *within(GENERAL, "number_*known_limits", "number_*known_limits_bak"),
    ),
    mapped(
        "materials.pools.layers.folder; keys of the template are read as if they stood here",
        f"{LAYER}*.templatePath",
    ),
    mapped("materials.pools.layers.folder", f"{LAYER}*.path"),
    mapped("materials.pools.layers.tile_m: the stage's size over it", f"{LAYER}*.size"),
    mapped(
        "materials.pools.layers.displacement_m",
        *within(f"{LAYER}*", "dispStrength", "dispColorStopColor_?", "dispmapStrength"),
    ),
    no_counterpart(
        "height maps are used as they are, without a ramp's stops",
        f"{LAYER}*.dispColorStopPosition_?",
    ),
    mapped("materials.pools.layers.normal_strength", f"{LAYER}*.normalStrength"),
    mapped("materials.pools.layers.anti_tiling", f"{LAYER}*.tilingMode"),
    mapped(
        "materials.pools.layers.anti_tiling, rotation_deg: half of it to either side",
        f"{LAYER}*.mosaicRotation",
    ),
    no_counterpart("cells of anti-tiling have borders of one kind", f"{LAYER}*.mosaicNoise"),
    no_counterpart(
        "tiles are square, and cells of anti-tiling as large as a tile",
        *within(f"{LAYER}*", "imageTile?", "scaleFileFac", "scaleYXRatio"),
    ),
    no_counterpart(
        "the maps that a folder has are used",
        *within(f"{LAYER}*", "diffuse", "ref", "spec", "normal", "displacement", "emission"),
    ),
    mapped(
        "materials.pools.layers.color.curves",
        f"{LAYER}*.colorAdjustment.?ColorPoints",
    ),
    mapped("materials.pools.layers.color.hue_deg", f"{LAYER}*.colorVariation.hue"),
    mapped("materials.pools.layers.color.saturation", f"{LAYER}*.colorVariation.saturation"),
    mapped("materials.pools.layers.color.value", f"{LAYER}*.colorVariation.brithness"),
    no_counterpart(
        "colour varies from batch to batch, and by materials.variation from place to place",
        f"{LAYER}*.colorVariation.merging*",
    ),
    mapped(
        "materials.pools.layers.semantic_id, levels, labels_from",
        f"{LAYER}*.passParams.semantic_label.labelIDVec*",
    ),
    no_counterpart("colours and instances need no parameters", f"{LAYER}*.passParams.*"),
    no_counterpart("there is one stage", f"{STAGE}.name"),
    mapped("stage.preset or stage.mesh", f"{STAGE}.type"),
    mapped("stage.extent_m", f"{GROUND}.stageSizeX"),
    mapped("stage.preset", f"{GROUND}.stageLandscapePreset"),
    mapped("materials", f"{GROUND}.assetMaterial"),
    no_effect("a name within Blender", f"{GROUND}.stageName"),
    no_counterpart("each batch draws its own ground from the seed", f"{ANT}.random_seed"),
    no_effect(
        "a switch of the add-on's user interface, or of what it does beside the terrain",
        *within(ANT, "show_*", "refresh", "auto_refresh", "texture_block", "at_cursor"),
        *within(ANT, "land_material", "water_*", "vert_group", "smooth_mesh", "tri_face"),
        *within(ANT, "sphere_mesh", "remove_double", "mesh_size", "ant_terrain_name"),
    ),
    no_counterpart("a parameter of the add-on's noise; stage.preset has its own shape", f"{ANT}.*"),
    mapped("stage.mesh.file", f"{GROUND}.stageFilePath"),
    mapped("stage.mesh.object", f"{GROUND}.meshInstanceName"),
    mapped(
        "stage.preset: a ground of noise instead of the mesh, which is not displaced",
        f"{GROUND}.stageDisplacementActive",
    ),
    mapped("stage.relief_m", f"{GROUND}.stageDisplacementStrength"),
    no_counterpart("the median height comes to z = 0", f"{GROUND}.stageDisplacementMidLevel"),
    no_counterpart("there is one kind of such noise", f"{GROUND}.stageDisplacementNoise*"),
    no_counterpart("see stage.detail", *within(GROUND, "stagedDicing*", "NOSUBSURF")),
    no_counterpart("a mesh's own materials and particles are left out", f"{GROUND}.noCleaning"),
    no_counterpart(
        "a mesh's own materials and particles are left out", f"{GROUND}.particleSystems.*"
    ),
    mapped("assets.groups.name or assets.objects.name", f"{MESH}.name"),
    mapped("assets.groups (MeshMultipleRandom) or objects (MeshAsteroid)", f"{MESH}.type"),
    mapped("assets.*.file", f"{THING}.meshFilePath"),
    mapped("assets.*.object_name", f"{THING}.meshInstanceName"),
    mapped(
        "assets.groups.count",
        *within(THING, "numberInstances"),
        f"{THING}.densityMapSettings.numberInstances",
    ),
    mapped(
        "assets.groups.probability; objects are always there",
        *within(THING, "randomSwitchOnOff"),
    ),
    no_counterpart("objects are always there", f"{THING}.activationProbability"),
    no_effect(
        "the key outside densityMapSettings decides",
        f"{THING}.densityMapSettings.randomSwitchOnOff",
    ),
    no_counterpart("everything has an instance id", f"{THING}.instanceLabelActive"),
    no_counterpart(
        "ids of instances reach as far as needed", f"{THING}.numInstanceLabelPerChannel"
    ),
    mapped("assets.groups.density", f"{THING}.useDensityMap"),
    mapped("assets.groups.density.kind", f"{DENSITY}.noiseType"),
    mapped("assets.groups.density: its cells' or patches' size", *within(DENSITY, "size", "scale")),
    mapped(
        "assets.groups.density.cover, roughly",
        *within(DENSITY, "intensity", "colorStopPosition_?", "colorStopColor_?"),
    ),
    no_counterpart("there are no gradients across a stage", f"{DENSITY}.progression"),
    no_effect("nothing reads it", f"{THING}.refreshFreq"),
    mapped("assets.groups.size_m", *within(THING, "defaultSize", "strengthRandomScale")),
    mapped("assets.groups.yaw_deg, tilt_deg", f"{THING}.randomRotationEnabled"),
    mapped("assets.groups.align", f"{THING}.rotationOptionMode"),
    mapped("assets.groups.tilt_deg", f"{THING}.rotationOptionFactor"),
    mapped("assets.groups.yaw_deg", f"{THING}.rotationOptionPhase*"),
    no_counterpart(
        "things are scattered over the stage", *within(THING, "meshEmitter", "emitterFilePath")
    ),
    no_counterpart("there is one stage", f"{THING}.appliedOnStage"),
    no_counterpart("turn the mesh in its file", f"{THING}.preRotationDeg"),
    mapped("assets.*.semantic_id, levels", f"{THING}.passParams.semantic_label.labelIDVec*"),
    no_counterpart("colours and instances need no parameters", f"{THING}.passParams.*"),
    mapped("assets.objects.texture, semantic_id, levels", f"{THING}.assetMaterial"),
    mapped("assets.objects.position_m", *within(THING, "location", "trajectorySimulation")),
    mapped("assets.objects.quat_xyzw", *within(THING, "rotation_deg", "rotation_rad")),
    no_counterpart("an object's attitude is given", f"{THING}.random_rotation"),
    no_counterpart("raises an error there", f"{THING}.scale"),
    no_counterpart("output.samples is one for all", f"{THING}.numSamples"),
    no_counterpart(
        "an object stays where it is, the rig moves; assets.movers can follow a CSV file",
        f"{FLIGHT}.*",
        f"{THING}.assetDistanceScale",
    ),
    no_counterpart("shapes from files are not displaced", f"{DISPLACED}.*"),
    no_counterpart("there is one kind of object", f"{THING}.NOSUBSURF"),
    no_effect("nothing reads it", "ASSET_SETUP.GENERAL.*"),
)
