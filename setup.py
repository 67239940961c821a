# Copyright 2026 The mecarover_serial authors
# SPDX-License-Identifier: Apache-2.0
"""The package for colcon (ament_python) and for pip; both end with a working `ros2 run`."""
from glob import glob
from os.path import isfile
from pathlib import Path
import re
from xml.etree import ElementTree

from setuptools import find_packages
from setuptools import setup

NAME = 'mecarover_serial'
TOOLS = [Path(name).name for name in sorted(glob('resource/executables/*'))]
DASHBOARD = ['aiohttp>=3.9', 'prometheus-client>=0.16']
MCAP = ['rosbags>=0.10.9']
DOCS = ['sphinx>=7', 'myst-parser']

# Resolved: colcon --symlink-install runs a link to this file in its build folder.
HERE = Path(__file__).resolve().parent
PACKAGE = ElementTree.parse(HERE / 'package.xml').getroot()     # the home of version and names
SITE = {url.get('type'): url.text for url in PACKAGE.findall('url')}

setup(
    name=NAME,
    version=PACKAGE.findtext('version'),
    description='Finds what is wrong with a bus of Dynamixel or Feetech servos, without ever '
                'sending, and drives a rover from ROS 2',
    # An index has no other files: links and pictures lead to the repository.
    long_description=re.sub(
        r'(!?)(\[[^]]*\]\()(?!http|#)',
        lambda link: f"{link[0]}{SITE['repository']}/{'raw' if link[1] else 'blob'}/main/",
        (HERE / 'README.md').read_text('utf-8')),
    long_description_content_type='text/markdown',
    maintainer=PACKAGE.findtext('maintainer'),
    maintainer_email=PACKAGE.find('maintainer').get('email'),
    project_urls=SITE,
    license='Apache-2.0',
    keywords='dynamixel feetech servo bus monitor diagnostics ros2 lerobot serial robot',
    classifiers=[
        'Development Status :: 4 - Beta', 'Intended Audience :: Developers',
        'Intended Audience :: Science/Research', 'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Topic :: Scientific/Engineering', 'Topic :: System :: Hardware'],
    python_requires='>=3.10',
    packages=find_packages(include=[
        'msg_defs', 'servobus*', NAME, 'vel2d_bridge', 'dxl_monitor', 'mecarover_dashboard',
        'mecarover_fakes*']),
    package_data={'msg_defs': ['py.typed'],         # as in packaging/dxl-doctor
                  'servobus': ['py.typed'],
                  'servobus.model': ['files/*.yaml'],
                  'mecarover_fakes': ['factory.yaml'],
                  'servobus.tools.doctor': ['errors.yaml'],
                  'mecarover_dashboard': ['static/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
        # In one folder as here: settings and programs name docs/, deploy/ and firmware/.
        *((f'share/{NAME}/{Path(names).parent}', sorted(filter(isfile, glob(names))))
          for names in ('launch/*.launch.py', 'config/*', 'deploy/*', 'docs/*.md', 'docs/*.json',
                        'firmware/*', 'firmware/examples/*', 'firmware/examples/arduino/*')),
        # A wheel ignores setup.cfg's install_scripts: these files are what `ros2 run` finds
        # after `pip install`. colcon puts its own entry points of the same names there.
        ('lib/' + NAME, sorted(glob('resource/executables/*'))),
        # Made by scripts/release.
        ('share/man/man1', sorted(glob('resource/generated/man/*'))),
        ('share/bash-completion/completions', sorted(glob('resource/generated/bash/*'))),
        ('share/zsh/site-functions', sorted(glob('resource/generated/zsh/*'))),
        ('share/fish/vendor_completions.d', sorted(glob('resource/generated/fish/*'))),
    ],
    # The oldest are those of Ubuntu 24.04 and Raspberry Pi OS, and were tried.
    install_requires=['pyserial>=3.5', 'PyYAML>=6.0', 'crcmod-plus>=2.0'],
    extras_require={
        'ros': ['ros-jazzy-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces==5.3.6'],
        'dashboard': DASHBOARD,
        'mcap': MCAP,                       # dxl_dump -w FILE.mcap
        'test': ['pytest>=7.4', 'pytest-xdist>=3.7', 'hypothesis', 'jsonschema',
                 'dynamixel-sdk==4.1.0',
                 'feetech-servo-sdk==1.0.0', 'ruff', 'mypy', 'types-PyYAML', 'playwright',
                 # wheels only where they are sure to be: else it wants a Rust compiler
                 'rustypot==1.13.1; platform_machine == "x86_64"', 'axe-playwright-python',
                 *DOCS, *DASHBOARD, *MCAP, 'mcap>=1.2'],
        'docs': DOCS,
        'release': ['build', 'twine', 'shtab>=1.8', 'argparse-manpage>=4', 'bloom', *DASHBOARD],
        'mutation': ['mutmut>=3.8'],        # which changes to the core no test notices
    },
    entry_points={'console_scripts': [
        f'{tool} = {NAME}.command:{tool}' for tool in TOOLS]},
    zip_safe=False,
)
