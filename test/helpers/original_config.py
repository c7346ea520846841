"""Configurations of the original simulator's structure, with the keys that it knows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

Json = dict[str, Any]


def rig() -> Json:
    return {
        "baseMovement": {"movementType": "none", "hoverBaseDistance": 2.0},
        "stepInterval": 2,
        "sensorMovementType": "randomEuclideanTarget",
        "hoverBaseModeEnabled": True,
        "hoverBaseStage": "ground",
        "hoverBaseDistance": [2.0, 3.0],
        "hoverBaseDistanceNoise": 0.1,
        "hoverTargetModeEnabled": True,
        "hoverTargetStage": "ground",
        "hoverTargetDistance": 0.25,
        "positionOffsetEnabled": True,
        "randomEuclideanPosMin": [-4.0, -5.0, 1.0],
        "randomEuclideanPosMax": [4.0, 5.0, 2.0],
        "randomEuclideanEulerMin": [0, 0, 0],
        "randomEuclideanEulerMax": [0, 0, 0],
        "randomTargetPosMin": [-6.0, -7.0, -2.0],
        "randomTargetPosMax": [6.0, 7.0, -1.0],
        "randomTargetEulerMin": [0, 0, 0],
        "randomTargetEulerMax": [0, 0, 0],
        "randomTargetRollDeg": [-3.0, 4.0],
        "interpolationMode": "none",
        "targetObjectActive": True,
        "tragetObjectMovementType": "random",
        "MESH_FOLLOWER": {"meshFilePath": "rover.blend", "transformation": [0, 0, 0, 1, 0, 0, 0]},
    }


def camera() -> Json:
    return {
        "outputBaseName": "Eye-1",
        "imageResolution": [64, 48],
        "KMatrix": [50.0, 0, 32.5, 0, 51.0, 22.5, 0, 0, 1],
        "transformation": [0.1, 0.2, 0.3, 1, 0, 0, 0],
        "triggerInterval": 2,
        "cameraFocalLength": 70,
        "stereoBaseLine": 0.2,
        "depthOfField": {
            "distance": 7.0,
            "fStop": 2.0,
            "blades": 5,
            "rotationDeg": 9,
            "ratio": 1.5,
        },
        "renderPasses": {
            "RGBDPass": {"activationSlot": [1], "DepthEnabled": True},
            "SemanticPass": {"activationSlot": [1, 0, 1]},
            "InstancePass": {"activationSlot": [1]},
        },
    }


def texture() -> Json:
    return {
        "path": "maps/red_sand/",
        "diffuse": True,
        "normal": True,
        "normalStrength": 0.5,
        "size": 10.0,
        "dispStrength": 0.04,
        "dispColorStopPosition_0": 0.0,
        "imageTileX": 1.0,
        "mosaicRotation": 90.0,
        "mosaicNoise": 0.8,
        "colorAdjustment": {"cColorPoints": [[0.5, 0.6]], "gColorPoints": [[0.2, 0.3]]},
        "colorVariation": {
            "hue": 0.55,
            "saturation": 1.2,
            "brithness": 0.9,
            "mergingMode": "MIX",
        },
        "passParams": {"rgb": {}, "semantic_label": {"labelIDVec": [[11, 12, 0]]}},
    }


def sky() -> Json:
    return {
        "stepIntervalOption": "GLOBAL",
        "stepInterval": 5,
        "SunSize": [0.5],
        "SunIntensity": [0.5, 1.0],
        "SunElevation": [10.0, 20.0],
        "SunRotation": [30.0, 60.0],
        "SunAltitude": [100.0, 200.0],
        "AirDensity": [0.5, 1.0],
        "DustDensity": [1.0, 2.0],
        "OzoneDensity": [2.0, 3.0],
        "SunStrength": [0.1],
        "passParams": {
            "RGBDPass": {"rgbIDVec": [1]},
            "SemanticPass": {"semanticIDVec": [40, 41]},
            "InstancePass": {"instanceIDVec": [-1]},
        },
    }


def rocks() -> Json:
    return {
        "meshFilePath": "meshes/rocks.blend",
        "meshInstanceName": "rock_a",
        "numberInstances": [1, 2],
        "randomSwitchOnOff": False,
        "instanceLabelActive": True,
        "useDensityMap": True,
        "densityMapSettings": {
            "numberInstances": [20, 30],
            "randomSwitchOnOff": True,
            "densityMap": {
                "noiseType": "VORONOI",
                "intensity": 1.0,
                "size": 0.5,
                "colorStopPosition_0": 0.2,
                "colorStopColor_0": [0, 0, 0, 1],
                "colorStopPosition_1": 0.6,
                "colorStopColor_1": [1, 1, 1, 1],
            },
        },
        "refreshFreq": 3,
        "defaultSize": 2.0,
        "strengthRandomScale": 0.75,
        "randomRotationEnabled": True,
        "rotationOptionMode": "NOR",
        "rotationOptionFactor": 0.2,
        "rotationOptionPhase": 0.5,
        "rotationOptionPhaseRandom": 0.25,
        "meshEmitter": "STAGE",
        "appliedOnStage": "ground",
        "preRotationDeg": [0, 0, 90],
        "passParams": {"semantic_label": {"labelIDVec": [[21, 22]]}, "rgb": {"x": 1}},
    }


def document() -> Json:
    """Return a world with a stage."""
    return {
        "SIMULATION_SETUP": {
            "outputPath": "somewhere",
            "defaultCfg": "",
            "numBatches": 2,
            "numSamplesPerBatch": 3,
            "renderImages": True,
            "saveBlenderFiles": True,
            "saveMetaData": True,
            "outputIDOffset": 4,
        },
        "RENDER_SETUP": {
            "GENERAL": {"renderEngine": "CYCLES", "renderDevice": "GPU", "performanceTilesX": 8},
            "RENDER_PASSES": [
                {
                    "type": "RGBDPass",
                    "passParams": {
                        "numIter": 1,
                        "renderDepthActive": True,
                        "renderSamples": 7,
                        "lightPathesMaxBounces": 3,
                    },
                },
                {"type": "SemanticPass", "passParams": {"numIter": 3, "imageFileType": "PNG"}},
                {"type": "InstancePass", "passParams": {"numIter": 1}},
            ],
        },
        "RENDER_POST_PROCESSING_EFFECTS_SETUP": {
            "GENERAL": {"renderPasses": ["combined"]},
            "POST_EFFECTS": [
                {
                    "type": "BloomEffect",
                    "effectParams": {"quality": "HIGH", "threshold": 0.7, "size": 6, "mix": 0.0},
                }
            ],
        },
        "SENSOR_SETUP": {
            "GENERAL": rig(),
            "SENSORS": [{"type": "SensorCameraRGBD", "sensorParams": camera()}],
        },
        "ENVIRONMENT_EFFECTS_SETUP": {
            "GENERAL": {"backgroundStrength": [0.1, 0.2], "stepInterval": 3},
            "ENVIRONMENT_EFFECTS": [
                {
                    "type": "EnvLightBlenderSky",
                    "stepInterval": 1,
                    "environmentEffectsParams": sky(),
                }
            ],
        },
        "ASSET_SETUP": {
            "MATERIALS": [
                {
                    "name": "terrain",
                    "type": "MaterialTerrain",
                    "materialParams": {
                        "general": {
                            "minNumMixTerrains": 1,
                            "maxNumMixTerrains": 2,
                            "hardLabelBorders": False,
                            "withReplacement": True,
                            "dispMidLevel": 0.5,
                            "dispScale": 2.0,
                            "normalStrength": 1.5,
                            "mergingNoise": {
                                "Scale": [2.0, 4.0],
                                "Detail": [1.0, 2.0],
                                "Roughness": [0.1, 0.4],
                                "Distortion": [0.0, 0.3],
                            },
                        },
                        "terrainTextureList": [texture()],
                    },
                }
            ],
            "STAGES": [
                {
                    "name": "ground",
                    "type": "StageBlenderLandscape",
                    "stageParams": {
                        "stageName": "landscape",
                        "stageSizeX": 40,
                        "stageLandscapePreset": "dunes",
                        "assetMaterial": "terrain",
                        "landscapeParams": {"random_seed": [0, 9], "noise_size": [1.0]},
                    },
                }
            ],
            "MESHES": [{"name": "rocks", "type": "MeshMultipleRandom", "meshParams": rocks()}],
        },
    }


def online() -> Json:
    """Return a world that clients step, with a mesh from a Blender file as its stage."""
    world = document()
    world["SENSOR_SETUP"]["GENERAL"]["onlineMode"] = True
    world["ASSET_SETUP"]["STAGES"] = [
        {
            "name": "ground",
            "type": "StageBlenderObject",
            "stageParams": {
                "meshInstanceName": "landscape",
                "stageFilePath": "stages/ground.blend",
                "stageName": "landscape",
                "stageDisplacementActive": False,
                "stageSizeX": 200,
                "assetMaterial": "terrain",
                "landscapeParams": {"random_seed": [0, 9]},
            },
        }
    ]
    return world


def space() -> Json:
    """Return a body without a stage, in front of a rig that looks at it."""
    world = document()
    world["ASSET_SETUP"]["STAGES"] = []
    world["ASSET_SETUP"]["MATERIALS"][0]["type"] = "MaterialAsteroid"
    world["ASSET_SETUP"]["MESHES"] = [
        {
            "name": "body",
            "type": "MeshAsteroid",
            "meshParams": {
                "meshFilePath": "meshes/body.obj",
                "location": "trajectory_simulation",
                "trajectorySimulation": [0, 0, 0, 0, 0, 0],
                "assetDistanceScale": [1.2, 1.4],
                "random_rotation": True,
                "rotation_deg": [0, 0, 90],
                "assetMaterial": "terrain",
                "activationProbability": 0.3,
                "trajectoryParams": {"trajectoryType": {"mode": "direct"}, "rotationPeriod": 8.0},
                "assetDisplacementParams": {"assetDisplacementActive": False},
                "passParams": {"semantic_label": {"labelIDVec": [[31]]}},
            },
        }
    ]
    world["SENSOR_SETUP"]["GENERAL"] = {
        "sensorMovementType": "centeredTarget",
        "sensorDistanceScale": [2.0, 3.0],
        "landingMode": False,
        "finalApproachDistance": 1.1,
        "hoverBaseModeEnabled": False,
        "hoverBaseDistance": [0.3, 6.0],
        "targetObject": "body",
    }
    params = world["SENSOR_SETUP"]["SENSORS"][0]["sensorParams"]
    params["transformation"] = [0, 0, 0, 0, 0, 0, 0]
    return world


def write(data: Json, folder: Path) -> Path:
    path = folder / "original.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path
